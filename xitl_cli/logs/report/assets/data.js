// What the page knows, its colours and its clock.

const find = (selector, within = document) => within.querySelector(selector);
const all = (selector, within = document) => [...within.querySelectorAll(selector)];
const root = document.documentElement;
const page = JSON.parse(find("#page").textContent);
const whole = page.range;
const state = { range: whole, at: null, held: false, marks: {}, theme: "auto", printing: false };
const plots = [];
const severities = ["fine", "notice", "warning", "critical"];
const MOST_MARKS = 400;

const dark = matchMedia("(prefers-color-scheme: dark)");
const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
const traceColour = (index) => colour(`trace${(index % 8) + 1}`);
const modeNames = [...new Set(page.marks.filter((mark) => mark.kind === "mode").map((mark) => mark.text))];
const modeColour = (name) => traceColour(modeNames.indexOf(name));
const stored = (value) => {
  try {
    if (value !== undefined) localStorage.setItem("xitl-theme", value);
    return localStorage.getItem("xitl-theme");
  } catch { return null; } // a page from disk may have no storage
};
const applyTheme = () => {
  const wanted = state.printing ? "light" : state.theme === "auto" ? (dark.matches ? "dark" : "light") : state.theme;
  root.dataset.theme = wanted;
  find("#theme").textContent = { auto: "Auto", light: "Light", dark: "Dark" }[state.theme];
};

const clock = (at, decimals) => {
  const ticks = Math.round(Math.abs(at) * 10 ** decimals);
  const seconds = Math.floor(ticks / 10 ** decimals);
  const pad = (number) => String(number).padStart(2, "0");
  const hours = Math.floor(seconds / 3600), minutes = Math.floor(seconds / 60) % 60;
  const text = (hours ? `${hours}:${pad(minutes)}` : minutes) + ":" + pad(seconds % 60);
  const part = decimals ? "." + String(ticks % 10 ** decimals).padStart(decimals, "0") : "";
  return (at < 0 && ticks ? "-" : "") + text + part;
};
const fine = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1].flatMap((power) => [power, 2 * power, 5 * power]);
const steps = [...fine, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];
const timeTicks = ([low, high], pixels) => {
  const step = steps.find((each) => each >= ((high - low) * 85) / pixels) ?? (high - low) / 4;
  const decimals = step >= 1 ? 0 : Math.min(6, Math.ceil(-Math.log10(step) - 1e-9));
  const count = Math.floor((high - low) / step) + 2, first = Math.ceil(low / step);
  const tickvals = Array.from({ length: count }, (_, index) => (first + index) * step).filter((at) => at <= high);
  return { tickmode: "array", tickvals, ticktext: tickvals.map((at) => clock(at, decimals)) };
};
const shortNumber = (value) =>
  !Number.isFinite(value) ? "–" : value === 0 ? "0" : Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3
    ? value.toExponential(3) : String(Number(value.toPrecision(5)));

// Data

const decode = (array) => {
  if (array.type === "constant") return new Float64Array(array.many).fill(array.value);
  const bytes = Uint8Array.from(atob(array.data), (letter) => letter.charCodeAt(0)).buffer;
  if (array.type === "f4") return new Float32Array(bytes);
  if (array.type === "f8") return new Float64Array(bytes);
  return Float64Array.from(new Uint32Array(bytes), (count) => array.first + count * array.step);
};
const load = (plot) => {
  if (plot.data) return;
  plot.data = JSON.parse(find("script", plot.figure).textContent);
  for (const trace of plot.data.traces ?? []) { trace.x = decode(trace.x); trace.y = decode(trace.y); trace.shown = true; }
  for (const track of plot.data.tracks ?? [])
    for (const key of ["t", "east", "north", "speed"]) if (track[key]) track[key] = decode(track[key]);
  if (plot.data.traces) legend(plot);
};
/** Index of the last element that is not greater than `at`, or -1. */
const before = (sorted, at) => {
  let low = 0, high = sorted.length;
  while (low < high) { const middle = (low + high) >> 1; if (sorted[middle] <= at) low = middle + 1; else high = middle; }
  return low - 1;
};
const near = (sorted, at) => {
  const index = before(sorted, at);
  return index + 1 < sorted.length && (index < 0 || sorted[index + 1] - at < at - sorted[index]) ? index + 1 : index;
};
const modeAt = (at) => page.marks.find((mark) => mark.kind === "mode" && mark.from <= at && at < mark.until)?.text;
