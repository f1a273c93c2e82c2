// Signals and expressions that the reader names, drawn a plot a unit.

const SUGGESTED = [
  "wrap180(NTUN.DesYaw - ATT.Yaw)", "wrap180(ATT.DesYaw - ATT.Yaw)", "THR.DesSpeed - THR.Speed", "STER.DesTurnRate - STER.TurnRate",
  "hypot(XKF1.VN, XKF1.VE)", "hypot(XKF1.VN, XKF1.VE) - GPS.Spd", "hypot(IMU.AccX, IMU.AccY, IMU.AccZ)", "degrees(ATTITUDE.roll)",
  "hypot(/truth/state.velocity_ned_mps[0], /truth/state.velocity_ned_mps[1])",
  "/truth/odometry.pose.pose.position.x - /estimate/odometry.pose.pose.position.x", "/actuators.command[0] - /actuators.command[1]",
];
const picker = () => {
  const form = find("#pick");
  if (!form) return;
  let sources = null;
  const picks = [], input = find("#picking"), refused = find("#refused");
  const element = (tag, text, extra = {}) => Object.assign(document.createElement(tag), { textContent: text, ...extra });
  const open = () => {
    if (sources) return sources;
    sources = all("script.held").map((held) => JSON.parse(held.textContent));
    for (const { tables } of sources) for (const table of tables) {
      table.t = decode(table.t);
      for (const column of Object.values(table.columns)) {
        const { values } = column;
        Object.defineProperty(column, "values", { configurable: true, get() { const found = decode(values); Object.defineProperty(column, "values", { value: found }); return found; } });
      }
    }
    return sources;
  };
  const labelled = () => {
    const labels = new Map();
    for (const source of open()) for (const table of source.tables) {
      const label = expressions.tableLabel(table, source);
      labels.set(label, [...(labels.get(label) ?? []), ...Object.keys(table.columns)]);
    }
    return labels;
  };
  const found = (text) => {
    const drawn = [], errors = [];
    for (const source of open()) {
      try { drawn.push({ label: source.label, ...expressions.signalOf(source, text) }); } catch (error) { errors.push(error.message); }
    }
    if (!drawn.length) throw new Error(`${text} ${errors[0]}`);
    return drawn;
  };
  const redraw = () => {
    for (const figure of all("#picked figure")) drop(figure);
    const units = new Map(), said = new Set();
    for (const text of picks) for (const signal of found(text)) {
      const name = signal.label ? `${text} · ${signal.label}` : text;
      if (signal.others.length) said.add(`${name}: at the times of ${signal.base}, with ${signal.others.join(", ")} resampled`);
      for (const note of signal.notes) said.add(note);
      const traces = units.get(signal.unit) ?? [];
      traces.push({ name, x: signal.t, y: signal.values, style: signal.held ? "steps" : "line", shown: true });
      units.set(signal.unit, traces);
    }
    for (const [unit, traces] of units) {
      const figure = element("figure", "", { className: "plot time", tabIndex: 0 }), caption = document.createElement("figcaption");
      figure.dataset.find = "";
      caption.append(element("h3", traces.map(({ name }) => name).join(", ")));
      figure.append(caption, element("div", "", { className: "legend" }), element("div", "", { className: "canvas" }));
      find("#picked").append(figure);
      adopt(figure, { kind: "time", y: unit, traces, marks: [] });
    }
    find("#said").replaceChildren(...[...said].map((note) => element("li", note)));
    find("#chosen").replaceChildren(...picks.map((text) => element("button", `${text} ×`, {
      type: "button", title: "Remove", onclick: () => { picks.splice(picks.indexOf(text), 1); redraw(); },
    })));
  };
  const pick = (text) => {
    refused.textContent = "";
    try { found(text); } catch (error) { refused.textContent = error.message; return false; }
    if (!picks.includes(text)) picks.push(text);
    redraw();
    return true;
  };
  const choice = (text, shown = text) => element("button", shown, { type: "button", onclick: () => pick(text) });
  const columns = () => {
    const label = find("#messages").value;
    find("#columns").replaceChildren(...(labelled().get(label) ?? []).map((name) => choice(`${label}.${name}`, name)));
  };
  const prepare = () => {
    if (find("#messages").options.length) return;
    const labels = labelled();
    find("#messages").replaceChildren(new Option("a message …", ""), ...[...labels.keys()].map((label) => new Option(label, label)));
    find("#fields").replaceChildren(...[...labels].flatMap(([label, names]) => names.map((name) => new Option(`${label}.${name}`))));
    const known = SUGGESTED.filter((text) => { try { found(text); return true; } catch { return false; } });
    find("#suggested").replaceChildren(...(known.length ? [element("span", "For example")] : []), ...known.slice(0, 5).map((text) => choice(text)));
  };
  form.onsubmit = (event) => { event.preventDefault(); const text = input.value.trim(); if (text && pick(text)) input.value = ""; };
  find("#messages").onchange = columns;
  new IntersectionObserver((entries, watcher) => { if (entries.some((entry) => entry.isIntersecting)) { watcher.disconnect(); prepare(); } }, { rootMargin: "400px" }).observe(form);
};
