// One time for all plots: range, cursor, keys, the way from a finding to its evidence.

const zoomed = (plot, change) => {
  if (change["xaxis.autorange"]) return setRange(whole);
  const low = change["xaxis.range[0]"] ?? change["xaxis.range"]?.[0], high = change["xaxis.range[1]"] ?? change["xaxis.range"]?.[1];
  const y = change["yaxis.range[0]"] === undefined ? null : [change["yaxis.range[0]"], change["yaxis.range[1]"]];
  if (y && plot.kind === "time") plot.yRange = y;
  if (low !== undefined) setRange([Number(low), Number(high)], y ? plot : null);
  return undefined;
};
const setRange = ([low, high], keepsY = null) => {
  if (!(high > low)) return;
  const same = low <= whole[0] && high >= whole[1];
  state.range = same ? whole : [low, high];
  find("#whole").hidden = same;
  for (const plot of plots) if (plot !== keepsY) plot.yRange = null;
  renew((plot) => overTime(plot) || plot.kind === "track");
};
const setCursor = (at, held = false) => {
  if (state.held && !held && at === null) return;
  state.at = at; state.held = held;
  requestAnimationFrame(moveCursor);
};
const moveCursor = () => {
  const at = state.at, [low, high] = state.range, within = at !== null && at >= low && at <= high;
  for (const plot of plots) {
    if (!plot.drawn || !plot.visible) continue;
    if (plot.kind === "track") { moveSpot(plot, within); continue; }
    if (!overTime(plot)) continue;
    const { l, r, t, b } = margins(plot), width = plot.canvas.clientWidth - l - r;
    Object.assign(plot.cursor.style, { display: within ? "block" : "none", left: `${l + ((at - low) / (high - low)) * width}px`, top: `${t}px`, bottom: `${b}px` });
    if (plot.near) plot.near.textContent = within ? marksAt(plot.data.marks, at).slice(0, 3).map((mark) => mark.text).join(" · ") : "";
    for (const trace of plot.data.traces ?? []) {
      const row = !within || at > trace.x[trace.x.length - 1] ? -1 : trace.style === "steps" ? before(trace.x, at) : near(trace.x, at);
      trace.value.textContent = row < 0 ? "" : shortNumber(trace.y[row]);
    }
  }
  tell(within ? at : null);
};
const moveSpot = (plot, within) => {
  const [lead] = plot.data.tracks, axes = plot.canvas._fullLayout;
  const known = within && state.at >= lead.t[0] && state.at <= lead.t[lead.t.length - 1];
  plot.spot.style.display = known ? "block" : "none";
  if (!known) return;
  const row = near(lead.t, state.at);
  plot.spot.style.left = `${axes.xaxis._offset + axes.xaxis.l2p(lead.east[row])}px`;
  plot.spot.style.top = `${axes.yaxis._offset + axes.yaxis.l2p(lead.north[row])}px`;
};
const marksAt = (marks, at) => {
  const slack = (state.range[1] - state.range[0]) * 0.006;
  return marks.filter((mark) => mark.from - slack <= at && at <= mark.until + slack);
};
const tell = (at) => {
  const now = find("#now");
  now.replaceChildren();
  if (at === null) return;
  const time = document.createElement("b");
  const decimals = state.range[1] - state.range[0] > 20 ? 1 : 3;
  time.textContent = clock(at, decimals) + (at >= 60 ? ` = ${at.toFixed(decimals)} s` : "");
  const armed = page.marks.some((mark) => mark.kind === "armed" && mark.from <= at && at < mark.until) ? "armed" : "";
  const close = marksAt(page.marks.filter((mark) => mark.kind === "finding"), at)[0];
  now.append(time, ["", modeAt(at), armed, close?.text].filter((text) => text !== undefined && text !== "").map((text) => ` · ${text}`).join(""));
};
const timeUnder = (plot, event) => {
  const box = plot.canvas.getBoundingClientRect(), { l, r } = margins(plot);
  const part = (event.clientX - box.left - l) / (box.width - l - r);
  return part < 0 || part > 1 ? null : state.range[0] + part * (state.range[1] - state.range[0]);
};
const trackUnder = (plot, event) => {
  const box = plot.canvas.getBoundingClientRect(), { xaxis, yaxis } = plot.canvas._fullLayout, [lead] = plot.data.tracks;
  const x = event.clientX - box.left - xaxis._offset, y = event.clientY - box.top - yaxis._offset;
  let best = 30 * 30, at = null;
  lead.t.forEach((instant, row) => {
    if (instant < state.range[0] || instant > state.range[1]) return;
    const away = (xaxis.l2p(lead.east[row]) - x) ** 2 + (yaxis.l2p(lead.north[row]) - y) ** 2;
    if (away < best) { best = away; at = instant; }
  });
  return at;
};
const goTo = (button) => {
  const from = Number(button.dataset.from), until = Number(button.dataset.until);
  const room = Math.max(until - from, Math.min(10, (whole[1] - whole[0]) * 0.1), 1e-3);
  setRange([Math.max(whole[0], from - room), Math.min(whole[1], until + room)]);
  setCursor(from, true);
  replayAt(from);
  const section = document.getElementById(button.dataset.section);
  const target = find("figure.time", section) ?? find("#overview figure.bands, #overview figure.time") ?? section;
  target.scrollIntoView({ behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth", block: "center" });
  target.focus({ preventScroll: true });
};
const key = (event) => {
  const [low, high] = state.range, span = high - low, middle = state.at !== null && state.at > low && state.at < high ? state.at : (low + high) / 2;
  const moved = (by) => { const shift = Math.max(whole[0] - low, Math.min(whole[1] - high, by * span)); setRange([low + shift, high + shift]); };
  const scaled = (by) => setRange([Math.max(whole[0], middle - (middle - low) * by), Math.min(whole[1], middle + (high - middle) * by)]);
  const does = { ArrowLeft: () => moved(-0.2), ArrowRight: () => moved(0.2), "+": () => scaled(0.5), "=": () => scaled(0.5), "-": () => scaled(2), 0: () => setRange(whole), Escape: () => { state.held = false; setCursor(null); } }[event.key];
  if (does && !event.ctrlKey && !event.metaKey && !event.altKey) { event.preventDefault(); does(); }
};
