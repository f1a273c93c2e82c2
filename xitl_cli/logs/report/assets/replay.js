// The replay beside the map: a page of its own in a frame, in step with the cursor.

const replay = { frame: null, lateS: 0 };
const showReplay = () => {
  const figure = find("#replay"), stage = find(".stage", figure), button = find("#play");
  const shown = !replay.frame;
  replay.frame?.remove();
  replay.frame = null;
  button.textContent = shown ? "Hide" : "Show";
  button.setAttribute("aria-expanded", shown);
  figure.closest("section").classList.toggle("playing", shown);
  requestAnimationFrame(() => renew((plot) => plot.kind === "track"));
  if (!shown) return;
  const { html, lateS } = JSON.parse(find("#replay-page").textContent);
  const night = root.dataset.theme === "dark"; // the player has its colours from its own settings, the panel from a class
  replay.frame = Object.assign(document.createElement("iframe"), {
    title: "Replay in 3D",
    srcdoc: night ? html.replace("{darkMode:false}", "{darkMode:true}").replace(/<html/, '<html class="replay-dark"') : html,
  });
  replay.lateS = lateS;
  stage.append(replay.frame);
};
const replayAt = (at) => replay.frame?.contentWindow?.postMessage({ replayGoesTo: at + replay.lateS }, "*");
const prepareReplay = () => {
  if (!find("#replay")) return;
  find("#play").onclick = showReplay;
  addEventListener("message", (event) => {
    if (replay.frame && event.source === replay.frame.contentWindow && Number.isFinite(event.data?.replayShows)) setCursor(event.data.replayShows - replay.lateS, true);
  });
};
