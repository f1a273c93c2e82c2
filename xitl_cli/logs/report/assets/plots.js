// Drawing: each kind of plot from its data and the time in view.

const overTime = (plot) => plot.kind === "time" || plot.kind === "bands";
const margins = (plot) => plot.kind === "track" || plot.kind === "map"
  ? { l: 52, r: 10, t: 8, b: 34 } : { l: innerWidth < 500 ? 46 : 62, r: 12, t: 6, b: overTime(plot) ? 24 : 42 };
const axis = (extra) => ({
  gridcolor: colour("grid"), zerolinecolor: colour("line"), linecolor: colour("line"), zeroline: false, automargin: false, ...extra,
});
const layoutOf = (plot, xaxis, yaxis, extra = {}) => ({
  margin: margins(plot), height: plot.canvas.clientHeight, width: plot.width ?? plot.canvas.clientWidth,
  paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: false,
  modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("muted"), activecolor: colour("text") },
  font: { family: getComputedStyle(document.body).fontFamily, size: 11.5, color: colour("muted") },
  dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom", xaxis: axis(xaxis), yaxis: axis(yaxis), ...extra,
});
const timeAxis = (plot) => {
  const { l, r } = margins(plot);
  return { range: [...state.range], ...timeTicks(state.range, Math.max(120, (plot.width ?? plot.canvas.clientWidth) - l - r)) };
};
/** y over what is in view, with a little room. */
const fit = (plot) => {
  let low = Infinity, high = -Infinity;
  for (const { x, y, shown } of plot.data.traces) {
    if (!shown) continue;
    const first = Math.max(0, before(x, state.range[0])), last = Math.min(x.length - 1, before(x, state.range[1]) + 1);
    for (let index = first; index <= last; index++) {
      if (y[index] < low) low = y[index];
      if (y[index] > high) high = y[index];
    }
  }
  if (low > high) return undefined;
  const room = (high - low) * 0.06 || Math.abs(high) * 0.05 || 1;
  return [low - room, high + room];
};
const line = (mark, tone, soft) => mark.until > mark.from
  ? { type: "rect", yref: "paper", y0: 0, y1: 1, x0: mark.from, x1: mark.until, fillcolor: tone, opacity: soft, line: { width: 0 }, layer: "below" }
  : { type: "line", yref: "paper", y0: 0, y1: 1, x0: mark.from, x1: mark.from, line: { color: tone, width: 1, dash: "dot" }, layer: "below" };
const inView = (mark) => mark.until >= state.range[0] && mark.from <= state.range[1];
const begin = (mark) => ({ ...mark, until: mark.from });
/** Whether the whole span is worth a shade: many long ones would only darken each other. */
const shades = (mark) => mark.severity > 1 && mark.until - mark.from < 0.4 * (whole[1] - whole[0]);
const coversView = (mark) => mark.from <= state.range[0] && mark.until >= state.range[1];
const shapes = (plot) => {
  const shown = page.marks.filter((mark) => state.marks[mark.kind] && inView(mark)).slice(0, MOST_MARKS);
  return [
    ...shown.filter((mark) => mark.kind === "mode").map((mark) => line(mark, modeColour(mark.text), 0.07)),
    ...shown.filter((mark) => mark.kind === "armed").map((mark) => ({ ...line(mark, colour("muted"), 0.6), y1: 0.025 })),
    ...shown.filter((mark) => mark.kind === "finding").map((mark) => line(shades(mark) ? mark : begin(mark), colour(severities[mark.severity]), 0.1)),
    // What only says how things were, and all the time, would colour the whole plot.
    ...plot.data.marks.filter((mark) => inView(mark) && (mark.severity > 0 || !coversView(mark)))
      .map((mark) => line(mark, colour(severities[mark.severity]), mark.severity > 1 ? 0.14 : 0.06)),
  ];
};
const trackMarker = (by, at, speed) => {
  if (by === "mode") return { color: at.map(modeAt).map((mode) => (mode === undefined ? colour("muted") : modeColour(mode))) };
  const bar = { title: { text: "m/s", side: "top" }, thickness: 10, len: 0.6, outlinewidth: 0 };
  return { color: speed, colorscale: "Viridis", showscale: true, colorbar: bar };
};
const trackLegend = (plot, by) => {
  const chips = by === "mode" ? modeNames.map((name) => [name, modeColour(name)]) : [];
  if (plot.data.tracks.length > 1) plot.data.tracks.forEach(({ name }, index) => {
    if (by === "track") chips.push([name, traceColour(index)]);
    else chips.push(index ? [name, colour("muted")] : [`${name}, by ${by}`, ""]);
  });
  find(".legend", plot.figure).replaceChildren(...chips.map(([name, tone]) => {
    const chip = document.createElement("span"), mark = document.createElement("i");
    chip.className = "chip"; mark.style.background = tone || "linear-gradient(90deg, #440154, #21918c, #fde725)";
    chip.append(mark, name);
    return chip;
  }));
};
/** A figure with the page's colours in place of their names, such as "--trace1". */
const coloured = (value) => {
  if (typeof value === "string") return value.startsWith("--") ? colour(value.slice(2)) : value;
  if (Array.isArray(value)) return value.map(coloured);
  return value && typeof value === "object" ? Object.fromEntries(Object.entries(value).map(([name, each]) => [name, coloured(each)])) : value;
};
/** Images, shapes and named points of the chart below a track, and ranges of the axes with room for labels. */
const chartOf = (plot) => {
  const { chart, tracks, waypoints } = plot.data;
  const range = (values) => {
    const low = Math.min(...values), high = Math.max(...values), room = 0.15 * Math.max(high - low, 20);
    return { range: [low - room, high + room] };
  };
  const ranges = ["east", "north"].map((axis, number) =>
    range([...tracks.flatMap((track) => [...track[axis]]), ...waypoints.map((point) => point[number + 1])]));
  if (!chart) return { points: [], layout: {}, ranges };
  const images = chart.tiles.map(({ source, west, north, width, height }) => ({
    source, x: west, y: north, sizex: width, sizey: height, sizing: "stretch", xref: "x", yref: "y", layer: "below",
  }));
  const path = (rings, end) => rings.map((ring) => `M${ring.map((place) => place.join()).join("L")}${end}`).join("");
  const shapes = chart.shapes.filter(({ kind }) => kind !== "point").map(({ kind, rings, name, fill, stroke, width }) => ({
    type: "path", path: path(rings, kind === "polygon" ? "Z" : ""), layer: "below", fillrule: "evenodd",
    fillcolor: kind === "polygon" ? fill : "rgba(0,0,0,0)", line: { color: stroke, width },
    label: { text: name.replace(/</g, "‹"), font: { color: colour("text"), size: 11 } },
  }));
  const marks = chart.shapes.filter(({ kind }) => kind === "point");
  const places = marks.map(({ rings }) => rings[0][0]);
  const points = marks.length ? [{
    x: places.map(([east]) => east), y: places.map(([, north]) => north), text: marks.map(({ name }) => name.replace(/</g, "‹")),
    mode: "markers+text", textposition: "bottom center", textfont: { color: colour("text"), size: 11 },
    marker: { size: 10, color: marks.map(({ marker }) => marker), line: { color: colour("text"), width: 1 } },
  }] : [];
  return { points, layout: { images, shapes }, ranges };
};
const draws = {
  time(plot) {
    const traces = plot.data.traces.map((trace, index) => {
      const dense = trace.x.length > 150, tone = traceColour(index);
      return {
        x: trace.x, y: trace.y, name: trace.name, visible: trace.shown, connectgaps: false,
        mode: trace.style === "points" ? "markers" : dense ? "lines" : "lines+markers",
        line: { width: 1.3, color: tone, shape: trace.style === "steps" ? "hv" : "linear" }, marker: { size: trace.style === "points" ? 4 : 3, color: tone },
      };
    });
    const range = plot.yRange ?? fit(plot);
    return [traces, layoutOf(plot, timeAxis(plot), range ? { range } : {}, { shapes: shapes(plot) })];
  },
  bands(plot) {
    const rows = ["finding", "armed", "mode"].filter((kind) => page.marks.some((mark) => mark.kind === kind));
    const { l, r } = margins(plot), width = (plot.width ?? plot.canvas.clientWidth) - l - r, boxes = [];
    for (const mark of page.marks.filter(inView).slice(0, 2 * MOST_MARKS)) {
      const row = rows.indexOf(mark.kind);
      const tone = mark.kind === "mode" ? modeColour(mark.text) : mark.kind === "armed" ? colour("muted") : colour(severities[mark.severity]);
      if (mark.kind === "finding" && mark.until <= mark.from) continue;
      const from = Math.max(mark.from, state.range[0]), until = Math.min(mark.until, state.range[1]);
      const room = ((until - from) / (state.range[1] - state.range[0])) * width;
      const text = mark.kind === "mode" && room > mark.text.length * 7 + 8 ? mark.text : "";
      boxes.push({
        type: "rect", x0: from, x1: until, y0: row - (mark.kind === "finding" ? 0.12 : 0.38), y1: row + (mark.kind === "finding" ? 0.12 : 0.38), layer: "below", line: { width: 0 }, fillcolor: tone,
        opacity: mark.kind === "mode" ? 0.28 : 0.4, label: { text: text.replace(/</g, "‹"), font: { color: colour("text"), size: 11 } },
      });
    }
    const instants = page.marks.filter((mark) => mark.kind === "finding").slice(0, MOST_MARKS);
    const points = {
      x: instants.map((mark) => mark.from), y: instants.map(() => rows.indexOf("finding")), mode: "markers", type: "scatter",
      marker: { size: 8, symbol: "diamond", color: instants.map((mark) => colour(severities[mark.severity])) },
    };
    const names = { finding: "findings", armed: "armed", mode: "mode" };
    const yaxis = { range: [-0.6, rows.length - 0.4], tickvals: rows.map((_, index) => index), ticktext: rows.map((kind) => names[kind]), fixedrange: true, showgrid: false };
    return [[points], layoutOf(plot, { ...timeAxis(plot), showgrid: false }, yaxis, { shapes: boxes })];
  },
  track(plot) {
    const { tracks, waypoints } = plot.data, by = find("select", plot.figure)?.value ?? "track", chart = chartOf(plot), traces = [...chart.points];
    const zoomed = state.range !== whole, inside = (at) => at >= state.range[0] && at <= state.range[1];
    // The first track is drawn last, over the others.
    [...tracks.entries()].reverse().forEach(([index, track]) => {
      const tone = traceColour(index), coloured = index === 0 && by !== "track", quiet = index > 0 && by !== "track";
      const width = quiet ? 1.2 : 2;
      const stroke = { x: track.east, y: track.north, mode: "lines", line: { width, color: coloured ? colour("line") : quiet ? colour("muted") : tone } };
      traces.push({ ...stroke, opacity: zoomed ? 0.35 : 1 });
      const rows = [...track.t.keys()].filter((row) => inside(track.t[row]));
      const pick = (array) => rows.map((row) => array[row]);
      const [x, y] = [pick(track.east), pick(track.north)];
      if (coloured) traces.push({ x, y, mode: "markers", marker: { size: 4.5, ...trackMarker(by, pick(track.t), track.speed && pick(track.speed)) } });
      else if (zoomed) traces.push({ ...stroke, x, y });
    });
    trackLegend(plot, by);
    const [lead] = tracks, last = lead.t.length - 1, where = (rows) => ({ x: rows.map((row) => lead.east[row]), y: rows.map((row) => lead.north[row]) });
    if (waypoints.length) traces.push({
      x: waypoints.map((point) => point[1]), y: waypoints.map((point) => point[2]), text: waypoints.map((point) => point[0]), mode: "lines+markers+text",
      textposition: "top right", textfont: { color: colour("text") }, line: { dash: "dot", width: 1, color: colour("muted") },
      marker: { symbol: "diamond-open", size: 9, color: colour("text") },
    });
    const findings = page.marks.filter((mark) => state.marks.finding && mark.kind === "finding" && mark.from >= lead.t[0] && mark.from <= lead.t[last]);
    traces.push({ ...where(findings.map((mark) => near(lead.t, mark.from))), mode: "markers",
      marker: { symbol: "x", size: 9, color: findings.map((mark) => colour(severities[mark.severity])) } });
    traces.push({ ...where([0, last]), mode: "markers+text", text: ["start", "end"], textposition: ["bottom left", "bottom right"], textfont: { color: colour("text") },
      marker: { symbol: ["circle", "square"], size: 10, color: colour("text") } });
    const [east, north] = chart.ranges;
    return [traces, layoutOf(plot, { title: { text: "east (m)", standoff: 4 }, ...east }, { title: { text: "north (m)", standoff: 4 }, scaleanchor: "x", ...north }, { dragmode: "pan", ...chart.layout })];
  },
  map(plot) {
    const [traces] = draws.xy(plot);
    return [traces, layoutOf(plot, { title: { text: plot.data.xLabel || "east (m)", standoff: 4 } }, { title: { text: plot.data.y, standoff: 4 }, scaleanchor: "x" }, { dragmode: "pan" })];
  },
  xy(plot, type) {
    const traces = plot.data.traces.map((trace, index) => ({
      x: trace.x, y: trace.y, visible: trace.shown, mode: trace.style === "points" ? "markers" : "lines",
      line: { width: 1.5, color: traceColour(index), shape: trace.style === "steps" ? "hv" : "linear" }, marker: { size: 4, color: traceColour(index) },
    }));
    const log = type === "log" ? { type, dtick: 1, exponentformat: "power", minor: { showgrid: true, gridcolor: colour("grid") } } : {};
    return [traces, layoutOf(plot, { ...log, title: { text: plot.data.xLabel, standoff: 4 } }, log)];
  },
  loglog: (plot) => draws.xy(plot, "log"),
  figure(plot) {
    const { data, layout } = coloured(plot.data.figure), { xaxis, yaxis, ...others } = layout;
    return [data, layoutOf(plot, { automargin: true, ...xaxis }, { automargin: true, ...yaxis }, { hovermode: "closest", ...others })];
  },
};
const render = (plot) => {
  load(plot);
  const [traces, layout] = draws[plot.kind](plot);
  for (const trace of traces) trace.type ??= "scatter";
  const buttons = [["toImage"]];
  const options = { displaylogo: false, modeBarButtons: buttons, toImageButtonOptions: { format: "svg", filename: plot.title }, scrollZoom: false };
  Plotly.react(plot.canvas, traces, layout, options);
  plot.dirty = false;
  if (plot.drawn) return;
  plot.drawn = true;
  plot.figure.dataset.drawn = "";
  for (const name of ["cursor", "spot"]) { plot[name] = document.createElement("div"); plot[name].className = name; plot.canvas.append(plot[name]); }
  plot.canvas.on("plotly_relayout", (change) => { if (overTime(plot)) zoomed(plot, change); });
  plot.canvas.on("plotly_doubleclick", () => { if (overTime(plot)) setRange(whole); });
};
const renew = (which = () => true) => {
  for (const plot of plots) if (plot.drawn && which(plot)) { plot.dirty = true; if (plot.visible || state.printing) render(plot); }
  moveCursor();
};
const legend = (plot) => {
  const row = find(".legend", plot.figure), label = document.createElement("span");
  label.className = "y"; label.textContent = plot.data.y; row.append(label);
  plot.data.traces.forEach((trace, index) => {
    const chip = document.createElement("button"), tone = document.createElement("i"), name = document.createElement("span");
    chip.className = "chip"; chip.type = "button"; chip.setAttribute("aria-pressed", "true"); chip.title = "Show or hide";
    tone.style.background = `var(--trace${(index % 8) + 1})`; name.textContent = trace.name;
    trace.value = document.createElement("b");
    chip.append(tone, name, ...(plot.kind === "time" ? [trace.value] : []));
    chip.onclick = () => { trace.shown = !trace.shown; chip.setAttribute("aria-pressed", trace.shown); render(plot); };
    row.append(chip);
  });
  plot.near = document.createElement("em");
  row.append(plot.near);
};
