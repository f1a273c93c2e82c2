/* Draws the instruments over viser's picture: values of one vessel, a dial with the directions, and the legend.
 *
 * The data are JSON in the texts of invisible labels: /instruments has the names of the vessels and the legend,
 * /instruments/NAME the values of a vessel. `xitlInstruments(parent, chosen)` draws them in another place than the
 * corner of the page, for the vessel whose name `chosen()` returns.
 */
"use strict";
(() => {
  const safe = (text) => String(text).replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
  const degrees = (value) => `${String(Math.round(value) % 360).padStart(3, "0")}°`;
  const textOf = (nodes, path) => nodes[path] && nodes[path].message.props.text;

  const TICKS = Array.from({ length: 12 }, (_, number) =>
    `<path class="tick" d="M0,-44V-${number % 3 ? 41 : 38}" transform="rotate(${30 * number})"/>`).join("");
  const arrow = (name, [speed, to], from, until) => speed < 0.01 ? "" :
    `<path class="${name}" d="M0,${from}V${until}M-5,${until + 7}L0,${until}L5,${until + 7}" transform="rotate(${to})"/>`;
  const dial = (values) => `<svg viewBox="-62 -62 124 124" role="img" aria-label="Heading ${values.heading_deg} degrees">
    <circle r="44"/>${TICKS}<text y="-27">N</text><text x="30" y="4">E</text><text y="35">S</text><text x="-30" y="4">W</text>
    ${values.desired_deg === null ? "" :
      `<path class="desired" d="M0,-45l-5,-10h10z" transform="rotate(${values.desired_deg})"/>`}
    ${values.heading_deg === null ? "" :
      `<path class="boat" d="M0,-22C8,-10 8,6 6,17H-6C-8,6 -8,-10 0,-22Z" transform="rotate(${values.heading_deg})"/>`}
    ${arrow("current", values.current, 40, 22)}${arrow("wind", values.wind, 60, 42)}</svg>`;
  const stream = ([speed, to]) => speed < 0.01 ? ["0", "m/s"] : [`${speed.toFixed(2)}`, `m/s → ${degrees(to)}`];
  const row = (name, value, unit, state) =>
    `<tr class="${state || ""}"><td>${safe(name)}</td><td>${value === null ? "–" : safe(value)}</td>` +
    `<td>${safe(value === null ? "" : unit)}</td></tr>`;
  const bar = ([name, command]) => {
    const share = 50 * Math.min(Math.abs(command), 1);
    return `<div class="bar"><span>${safe(name)}</span><i><b style="left:${command < 0 ? 50 - share : 50}%;` +
      `width:${share}%"></b></i><span>${Math.round(100 * command)} %</span></div>`;
  };
  const KEY = new Set(["over ground", "through water", "heading", "desired", "cross-track"]);
  const WORSE = new Set(["deadline misses", "frames lost"]);
  const state = (name, value) => WORSE.has(name) && Number(value) > 0 ? "bad" : "";

  const summary = (values) =>
    `<b>${safe(values.mode)}</b> <span class="${values.armed ? "armed" : ""}">${values.armed ? "armed" : "disarmed"}</span>` +
    `<span class="time">${values.time_s.toFixed(1)} s${values.paused ? " · paused" : ""}` +
    `${values.pace === null ? "" : ` · ${safe(values.pace)} ×`}</span>`;
  const key = (values) => `${dial(values)}<table>` +
    values.rows.filter(([name]) => KEY.has(name)).map((item) => row(...item)).join("") +
    row("wind", ...stream(values.wind)) + row("current", ...stream(values.current)) +
    (values.waypoint[1] ? row("waypoint", `${values.waypoint[0]}`, `of ${values.waypoint[1]}`) : "") + "</table>";
  const more = (values, legend) =>
    (values.motors.length ? `<div class="bars">${values.motors.map(bar).join("")}</div>` : "") +
    `<table>${values.rows.filter(([name]) => !KEY.has(name))
      .map(([name, value, unit]) => row(name, value, unit, state(name, value))).join("")}</table>` +
    `<div class="xitl-legend">${legend.map(([colour, name, scale]) =>
      `<span><i style="background:${colour}"></i>${safe(name)}${scale ? ` <small>${safe(scale)}</small>` : ""}</span>`
    ).join("")}</div>`;

  const make = (parent, chosen) => {
    const card = document.createElement("details");
    card.className = "xitl-instruments";
    card.open = true;
    card.innerHTML = "<summary></summary><select hidden></select><div class='key'></div>" +
      "<details class='more'><summary>more</summary><div></div></details>";
    const [head, select, main, rest] = card.children;
    rest.open = window.innerWidth > 700 && window.innerHeight > 560;
    let drawn = "";
    let known = "";
    const frame = () => {
      const tree = window.__viserSceneTree;
      const nodes = tree ? tree.getState() : {};
      const all = textOf(nodes, "/instruments");
      if (all) {
        const { vessels, legend } = JSON.parse(all);
        if (known !== String(vessels) && !chosen) {
          known = String(vessels);
          select.innerHTML = vessels.map((name) => `<option>${safe(name)}</option>`).join("");
          select.hidden = vessels.length < 2;
        }
        const name = chosen ? chosen() : vessels[Math.max(select.selectedIndex, 0)];
        const text = textOf(nodes, `/instruments/${name || "vessel"}`);
        if (text && drawn !== text + all) {
          drawn = text + all;
          const values = JSON.parse(text);
          head.innerHTML = summary(values);
          main.innerHTML = key(values);
          rest.lastChild.innerHTML = more(values, legend);
          if (!card.parentNode) (parent || document.body).append(card);
        }
      }
      window.requestAnimationFrame(frame);
    };
    frame();
    return card;
  };
  window.xitlInstruments = make;
  document.addEventListener("DOMContentLoaded", () => {
    if (!document.getElementById("replay-data")) make(null, null);
  });
})();
