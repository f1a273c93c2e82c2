// The page around the plots: filter, theme, printing; runs last.

const filter = () => {
  const wanted = find("#filter").value.trim().toLowerCase();
  let any = false;
  const matches = (element) => element.textContent.toLowerCase().includes(wanted);
  for (const section of all("main > section")) {
    const named = !wanted || matches(find("h2", section));
    let shown = named;
    for (const item of all("[data-find]", section).reverse()) {
      const text = item.matches("figure.plot") ? find("figcaption", item).textContent + (plots.find((plot) => plot.figure === item)?.names() ?? "") : null;
      const self = named || (text === null ? matches(item) : text.toLowerCase().includes(wanted));
      item.hidden = !self;
      shown ||= self;
    }
    for (const figure of all("figure.grid", section)) // a table whose title matches is shown whole
      if (!named && wanted && matches(find("figcaption", figure))) for (const row of all("tr", figure)) row.hidden = false;
    for (const closed of all("details", section)) if (wanted) closed.open = true;
    section.hidden = !shown;
    any ||= shown;
  }
  find("#none").hidden = any;
};
const printing = (on) => {
  state.printing = on;
  applyTheme();
  if (on) for (const closed of all("details:not([open])")) { closed.open = true; closed.dataset.opened = ""; }
  else for (const opened of all("details[data-opened]")) { opened.open = false; delete opened.dataset.opened; }
  for (const plot of plots) { plot.width = on ? 660 : undefined; if (on || plot.drawn) render(plot); }
};

const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    const plot = plots.find((each) => each.figure === entry.target);
    if (!plot) continue;
    plot.visible = entry.isIntersecting;
    if (plot.visible && (!plot.drawn || plot.dirty)) render(plot);
  }
}, { rootMargin: "300px" });
const adopt = (figure, data) => {
  const plot = { figure, canvas: find(".canvas", figure), kind: [...figure.classList].find((name) => name in draws), title: find("h3", figure).textContent };
  plot.names = () => { load(plot); return (plot.data.traces ?? []).map((trace) => trace.name).join(" "); };
  if (data) { plot.data = data; legend(plot); }
  plots.push(plot);
  plot.canvas.addEventListener("mousemove", (event) => {
    if (!plot.drawn) return;
    const at = overTime(plot) ? timeUnder(plot, event) : plot.kind === "track" ? trackUnder(plot, event) : null;
    if (at !== null) setCursor(at);
  });
  plot.canvas.addEventListener("click", () => { if (state.at !== null) replayAt(state.at); });
  plot.canvas.addEventListener("mouseleave", () => setCursor(null));
  if (overTime(plot)) figure.addEventListener("keydown", key);
  find("select", figure)?.addEventListener("change", () => render(plot));
  seen.observe(figure);
};
const drop = (figure) => {
  const index = plots.findIndex((plot) => plot.figure === figure);
  seen.unobserve(figure);
  if (plots[index].drawn) Plotly.purge(plots[index].canvas);
  plots.splice(index, 1);
  figure.remove();
};
const reading = new IntersectionObserver((entries) => {
  for (const entry of entries) find(`nav a[href="#${entry.target.id}"]`)?.classList.toggle("here", entry.isIntersecting);
}, { rootMargin: "-20% 0px -70% 0px" });

state.theme = stored() ?? "auto";
applyTheme();
for (const button of all(".toggle")) {
  state.marks[button.dataset.marks] = button.getAttribute("aria-pressed") === "true";
  button.onclick = () => {
    state.marks[button.dataset.marks] = !state.marks[button.dataset.marks];
    button.setAttribute("aria-pressed", state.marks[button.dataset.marks]);
    renew((plot) => plot.kind === "time" || plot.kind === "track");
  };
}
find("#theme").onclick = () => {
  state.theme = { auto: "light", light: "dark", dark: "auto" }[state.theme];
  stored(state.theme); applyTheme(); renew();
  if (replay.frame) { showReplay(); showReplay(); }
};
find("#whole").onclick = () => setRange(whole);
find("#filter").oninput = filter;
for (const button of all("button.at")) button.onclick = () => goTo(button);
dark.addEventListener("change", () => { applyTheme(); renew(); });
addEventListener("keydown", (event) => { if (event.key === "/" && event.target === document.body) { event.preventDefault(); find("#filter").focus(); } });
addEventListener("beforeprint", () => printing(true));
addEventListener("afterprint", () => printing(false));
let resized;
addEventListener("resize", () => { clearTimeout(resized); resized = setTimeout(() => renew(), 120); });
for (const figure of all("figure.plot")) adopt(figure);
picker();
prepareReplay();
for (const section of all("main > section")) reading.observe(section);
