/* Adds to viser's player: marks over its time line, numbers, events, findings and cameras that follow a vessel.
 *
 * The number field of the player holds the time. This script reads and sets it. Scene time is player time + `begin_s`.
 */
"use strict";
(() => {
  const replay = JSON.parse(document.getElementById("replay-data").textContent);
  const add = (kind, parent, name, text) => {
    const node = document.createElement(kind);
    if (name) node.className = name;
    if (text !== undefined) node.textContent = text;
    parent.append(node);
    return node;
  };
  const clock = (seconds) => {
    const tenths = Math.round(Math.abs(seconds) * 10);
    const minutes = Math.floor(tenths / 600);
    return `${seconds < 0 && tenths ? "-" : ""}${minutes}:${((tenths % 600) / 10).toFixed(1).padStart(4, "0")}`;
  };

  const field = () => document.querySelector(".mantine-NumberInput-input");
  const shownTime = () => parseFloat((field() || {}).value) || 0;
  const jump = (sceneTime) => {
    const input = field();
    if (!input) return;
    const value = Math.min(Math.max(sceneTime - replay.begin_s, 0), replay.duration_s);
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, value.toFixed(2));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  };

  /* Panel */
  document.title = replay.title;
  const panel = add("details", document.body, "replay-panel");
  panel.open = window.innerWidth > 700;
  const head = add("summary", panel);
  add("b", head, "", replay.title);
  const now = add("span", head, "replay-now");
  const cameras = add("div", panel, "replay-cameras");
  const subject = add("select", cameras);
  subject.title = "vessel";
  for (const vessel of replay.vessels) add("option", subject, "", vessel.name || "vessel");
  subject.hidden = replay.vessels.length < 2;
  const instruments = window.xitlInstruments(panel, () => replay.vessels[subject.selectedIndex].name);
  const lists = (title, rows, row) => {
    if (!rows.length) return null;
    const list = add("details", panel);
    add("summary", list, "", `${title} (${rows.length})`);
    const body = add("div", list, "replay-list");
    rows.forEach((item) => row(body, item));
    return list;
  };
  const entry = (body, time, text, name, more) => {
    const line = add("button", body, `replay-entry ${name}`);
    add("span", line, "replay-time", time === null ? "–" : clock(time));
    add("span", line, "", text);
    if (more) line.title = more;
    if (time === null) line.disabled = true;
    else line.onclick = () => jump(time);
    return line;
  };
  const findings = lists("Findings", replay.findings, (body, item) =>
    entry(body, item.time_s, item.sentence, `replay-${item.severity}`, item.next_step));
  if (findings) findings.open = true;
  const marks = lists("Events", replay.marks, (body, item) => entry(body, item.time_s, item.text, "replay-event"));
  if (marks && !findings) marks.open = true;
  lists("Notes", replay.notes, (body, item) => add("p", body, "replay-note", item));

  /* Marks over the time line */
  const strip = add("div", document.body, "replay-strip");
  const tick = (time, name, text) => {
    if (time === null) return;
    const node = add("i", strip, `replay-tick ${name}`);
    node.style.left = `${(100 * (time - replay.begin_s)) / replay.duration_s}%`;
    node.title = `${clock(time)} ${text}`;
    node.onclick = () => jump(time);
  };
  replay.marks.forEach((item) => tick(item.time_s, "replay-event", item.text));
  replay.findings.forEach((item) => tick(item.time_s, `replay-${item.severity}`, item.sentence));
  const layStrip = () => {
    const slider = document.querySelector(".mantine-Slider-root");
    strip.hidden = !slider;
    if (!slider) return;
    const track = (slider.querySelector(".mantine-Slider-track") || slider).getBoundingClientRect();
    strip.style.left = `${track.left}px`;
    strip.style.width = `${track.width}px`;
    strip.style.top = `${track.top - 9}px`;
  };

  let shown = NaN;
  const showTime = () => {
    const time = shownTime() + replay.begin_s;
    if (time === shown) return;
    shown = time;
    now.textContent = clock(time);
    if (window.parent !== window) window.parent.postMessage({ replayShows: time }, "*");
  };

  /* Camera */
  const turned = ([w, x, y, z], [a, b, c]) => {
    const tx = 2 * (y * c - z * b);
    const ty = 2 * (z * a - x * c);
    const tz = 2 * (x * b - y * a);
    return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
  };
  const viewer = () => window.__viserMutable;
  const pose = (vessel) => viewer().nodePoseData[vessel.path];
  const inPage = (place) => turned(viewer().nodePoseData[""].wxyz, place);
  let followed = true;
  const look = (from, at, smooth) => {
    viewer().cameraControl.setLookAt(...inPage(from), ...inPage(at), smooth);
    viewer().requestRender();
  };
  const views = {
    behind: (vessel, { position, wxyz }) => {
      const [east, north] = turned(wxyz, [1, 0, 0]);
      const level = Math.hypot(east, north) || 1;
      const [ahead, left, up] = vessel.behind_m;
      const from = [(ahead * east - left * north) / level, (ahead * north + left * east) / level, up];
      look(position.map((part, axis) => part + from[axis]), position, false);
    },
    beside: (vessel, { position, wxyz }) => {
      const [east, north] = turned(wxyz, [0, -1, 0]);
      const far = vessel.distance_m;
      look([position[0] + far * east, position[1] + far * north, position[2] + 0.2 * far], position, false);
    },
    above: (vessel, { position }) => {
      look([position[0], position[1] - 0.01, position[2] + 6 * vessel.distance_m], position, false);
    },
    all: () => {
      const [east, north] = replay.middle_en_m;
      look([east, north - 0.55 * replay.extent_m, 0.85 * replay.extent_m], [east, north, 0], false);
    },
  };
  const showView = (name) => {
    const vessel = replay.vessels[subject.selectedIndex];
    if (!viewer() || !viewer().cameraControl || !pose(vessel)) return;
    followed = name !== "all";
    views[name](vessel, pose(vessel));
  };
  for (const name of Object.keys(views)) add("button", cameras, "", name).onclick = () => showView(name);
  subject.onchange = () => showView("behind");
  let last = "";
  let ready = false;
  const follow = () => {
    const here = viewer();
    if (!here || !here.cameraControl || !field()) return;
    const at = pose(replay.vessels[subject.selectedIndex]);
    if (!at) return;
    if (!ready) {
      ready = true;
      showView(replay.view);
    }
    const key = at.position.join();
    if (!followed || key === last) return;
    last = key;
    here.cameraControl.moveTo(...inPage(at.position), false);
    here.requestRender();
  };
  const frame = () => {
    layStrip();
    showTime();
    follow();
    window.requestAnimationFrame(frame);
  };
  if (replay.at_s !== null) {
    const begin = window.setInterval(() => {
      if (!field()) return;
      window.clearInterval(begin);
      jump(replay.at_s);
    }, 100);
  }
  /* The page around this one can request an instant, and receives the time of the shown instant. */
  window.addEventListener("message", (event) => {
    if (event.source === window.parent && Number.isFinite(event.data?.replayGoesTo)) jump(event.data.replayGoesTo);
  });
  frame();
})();
