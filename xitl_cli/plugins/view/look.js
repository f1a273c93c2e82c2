/* Gives viser's scene the look of water, sky and wakes. The page works without it, with plain colours. It has plain
colours too without a graphics card. ?look=full and ?look=plain in its address decide otherwise.

viser keeps its scene in `window.__viserMutable`. Before each picture, `dress` replaces the shading of the node /water,
draws the sky behind everything, and paints the wakes on a map that the water shows. The server sends all other data:
the node /look has the time in s, the share of night and the speed of the wind as its position; the node /look/water
has the linear colour of the water; each node /wakes/NAME has the length and the beam of a vessel as its first point,
then east, north and time of its way. */
(() => {
  "use strict";
  const TILE_M = 9, TILE_PX = 256, MAP_PX = 256, KELVIN = Math.tan(19.47 * Math.PI / 180), LASTS_S = 40;
  const SKY = `
    uniform vec3 xSun, xZenith, xHaze, xGlow;
    vec3 skyColour(vec3 d) {
      float up = max(d.y, 0.0);
      float near = max(dot(d, xSun), 0.0), wide = near * near * near;
      return mix(xHaze, xZenith, up / (up + 0.22)) + 0.10 * wide * wide * xGlow;
    }
    vec3 glow(vec3 d, float narrow, float broad) { // of the sun in the sky, or mirrored
      float near = pow(max(dot(d, xSun), 0.0), 40.0), square = near * near;
      return xGlow * (narrow * square * square * square + broad * near);
    }`;
  const NOISE = `
    float xHash(vec2 p) { p = fract(p * vec2(123.34, 456.21)); p += dot(p, p + 45.32); return fract(p.x * p.y); }
    float xNoise(vec2 p) {
      vec2 i = floor(p), f = fract(p);
      f = f * f * (3.0 - 2.0 * f);
      return mix(mix(xHash(i), xHash(i + vec2(1, 0)), f.x), mix(xHash(i + vec2(0, 1)), xHash(i + vec2(1, 1)), f.x), f.y);
    }`;
  const SKY_VERTEX = `
    varying vec3 vAhead;
    void main() {
      vec4 p = inverse(projectionMatrix) * vec4(position.xy, 0.5, 1.0);
      vAhead = transpose(mat3(viewMatrix)) * (p.xyz / p.w);
      gl_Position = vec4(position.xy, 0.5, 1.0);
    }`;
  const SKY_FRAGMENT = SKY + NOISE + `
    uniform float xTime, xNight;
    varying vec3 vAhead;
    void main() {
      vec3 d = normalize(vAhead), colour = xHaze;
      if (d.y > 0.0) colour = skyColour(d) + glow(d, 0.25, 0.15); // most of the rest is water
      if (d.y > 0.02) {
        vec2 p = d.xz / (d.y + 0.12) * 1.3 + 0.004 * xTime;
        float cloud = 0.55 * xNoise(p) + 0.28 * xNoise(2.1 * p + 5.0) + 0.17 * xNoise(4.3 * p + 9.0);
        cloud = smoothstep(0.52, 0.86, cloud) * smoothstep(0.02, 0.22, d.y);
        colour = mix(colour, mix(vec3(0.97), 0.32 * xHaze + 0.06, xNight), 0.62 * cloud);
      }
      float disc = smoothstep(0.99985, 0.99993, dot(d, xSun));
      gl_FragColor = vec4(mix(colour, vec3(1.0, 0.99, 0.95), disc * (1.0 - xNight)), 1.0);
    }`;
  // Fresnel reflection of the sky, glitter of the sun, light from the water, foam; as the cameras draw it.
  const WATER_FRAGMENT = SKY + NOISE + `
    uniform vec3 xWater;       // light from below the surface
    uniform float opacity;
    varying vec3 vViewPosition, vNormal;
    uniform float xTime, xNight, xWind, xFar;
    uniform vec4 xMap;         // middle of the map of wakes, 1 / its size, 1 / the scale of foam
    uniform vec4 xEastNorth;   // directions of east and north
    uniform sampler2D xRipples, xWakes;
    vec3 inWorld(vec3 direction) { return normalize((vec4(direction, 0.0) * viewMatrix).xyz); }
    void main() {
      vec3 eye = inWorld(vViewPosition), wave = inWorld(vNormal);
      vec3 place = cameraPosition - transpose(mat3(viewMatrix)) * vViewPosition;
      float far = length(vViewPosition);
      float strength = (0.35 + 0.05 * min(xWind, 10.0)) / (1.0 + 0.012 * far);
      vec2 a = place.xz / ${TILE_M.toFixed(1)}, b = vec2(0.8 * a.x - 0.6 * a.y, 0.6 * a.x + 0.8 * a.y) * 0.37;
      vec4 one = texture2D(xRipples, a + 0.022 * xTime * vec2(0.8, 0.6));
      vec4 two = texture2D(xRipples, b - 0.011 * xTime * vec2(0.3, 0.9));
      vec2 slope = one.xy - 0.5 + 0.8 * (two.xy - 0.5);
      if (far < 40.0) {
        slope += (0.5 - 0.0125 * far) * (textureLod(xRipples, 4.7 * b + 0.05 * xTime * vec2(0.7, 0.5), 0.0).xy - 0.5);
      }
      slope *= strength;
      vec3 n = normalize(wave + vec3(slope.x, 0.0, slope.y));
      float facing = clamp(dot(n, eye), 0.0, 1.0);
      float away = 1.0 - facing, away2 = away * away;
      float fresnel = 0.02 + 0.98 * away2 * away2 * away / (1.0 + 0.9 * strength);
      vec3 back = reflect(-eye, n);
      back.y = abs(back.y) + 0.01;
      back = normalize(back);
      vec3 mirrored = skyColour(back);
      vec3 body = xWater * (0.62 + 0.5 * clamp(dot(n, xSun), 0.0, 1.0) + 1.4 * max(1.0 - wave.y, 0.0));
      body = sqrt(clamp(body, 0.0, 1.0)) * mix(0.94, 0.5, xNight);
      vec3 colour = mix(body, mirrored, fresnel);
      colour += glow(back, 1.5, 0.2) * (0.3 + 0.7 * fresnel);
      vec2 off = (place.xz - xMap.xy) * xMap.z;
      vec2 on = vec2(dot(off, xEastNorth.xy), dot(off, xEastNorth.zw)) + 0.5;
      float rough = 0.5 * (one.b + two.b);
      if (all(lessThan(abs(on - 0.5), vec2(0.5)))) {
        vec4 wake = texture2D(xWakes, on);
        float foam = 0.0;
        if (wake.r > 0.0) {
          vec2 at = place.xz * xMap.w;
          float grain = 0.5 * xNoise(5.0 * at) + 0.3 * xNoise(13.0 * at + 3.0) + 0.2 * rough;
          foam = 0.8 * smoothstep(0.0, 0.4, grain + 1.05 * wake.r - 0.92) * smoothstep(0.0, 0.15, wake.r);
        }
        colour *= 1.0 - 0.5 * wake.b;
        colour = mix(colour, vec3(mix(0.93, 0.45, xNight)), foam);
      }
      float share = clamp((xWind - 5.0) / 18.0, 0.0, 0.3);
      if (share > 0.0 && far < 250.0) {
        float crest = smoothstep(0.78 - share, 0.98 - share, xNoise(place.xz * 0.35 - 0.25 * xTime) * 0.75 + 0.35 * rough);
        float grain = 0.5 * xNoise(2.3 * place.xz + 0.2 * xTime) + 0.3 * xNoise(6.1 * place.xz - 0.3 * xTime) + 0.2 * rough;
        crest *= smoothstep(0.5, 0.62, rough) * mix(smoothstep(0.48, 0.72, grain), 0.5, smoothstep(20.0, 90.0, far));
        colour = mix(colour, vec3(mix(0.93, 0.42, xNight)), 0.7 * crest * smoothstep(2.0, 7.0, far));
      }
      colour = mix(colour, xHaze, 1.0 - exp(-max(far - 60.0, 0.0) / xFar));
      gl_FragColor = vec4(colour, mix(opacity, 1.0, max(fresnel, smoothstep(20.0, 200.0, far))));
    }`;

  let dressing = null;

  function ripples() {
    // Slopes of waves of random directions, in whole numbers of waves on the tile, so that its edges meet
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = TILE_PX;
    const context = canvas.getContext("2d"), image = context.createImageData(TILE_PX, TILE_PX);
    let seed = 7;
    const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
    const waves = [];
    for (let number = 0; number < 44; number += 1) {
      const turn = 1.1 * (random() + random() - 1) + (number % 5 === 0 ? Math.PI : 0);
      const count = 3 + 26 * random() * random();
      const kx = Math.round(count * Math.cos(turn)), ky = Math.round(count * Math.sin(turn));
      waves.push([kx, ky, 2 * Math.PI * random(), 1 / (4 + Math.hypot(kx, ky))]);
    }
    const slopes = new Float32Array(3 * TILE_PX * TILE_PX);
    const sums = [0, 0, 0];
    for (let row = 0, at = 0; row < TILE_PX; row += 1) {
      for (let column = 0; column < TILE_PX; column += 1, at += 3) {
        for (const [kx, ky, phase, size] of waves) {
          const angle = 2 * Math.PI * (kx * column + ky * row) / TILE_PX + phase, sine = size * Math.sin(angle);
          slopes[at] += kx * sine;
          slopes[at + 1] += ky * sine;
          slopes[at + 2] += 5 * size * Math.cos(angle);
        }
        for (let part = 0; part < 3; part += 1) sums[part] += slopes[at + part] ** 2;
      }
    }
    const scale = sums.map((sum) => 42 / Math.sqrt(sum / (TILE_PX * TILE_PX)));
    for (let at = 0, to = 0; at < slopes.length; at += 3, to += 4) {
      for (let part = 0; part < 3; part += 1) image.data[to + part] = 128 + scale[part] * slopes[at + part];
      image.data[to + 3] = 255;
    }
    context.putImageData(image, 0, 0);
    return canvas;
  }

  function texture(Texture, canvas, repeats) {
    const made = new Texture(canvas);
    made.wrapS = made.wrapT = repeats ? 1000 : 1001;
    made.generateMipmaps = repeats;
    made.minFilter = repeats ? 1007 : 1006;
    made.needsUpdate = true;
    return made;
  }

  /* The water's mesh, whose classes are those of three.js. */
  function waterOf(viewer) {
    let water = null;
    const node = viewer.nodeRefFromName["/water"];
    if (node) node.traverse((part) => { if (part.isMesh && part.material.isMeshStandardMaterial) water = part; });
    return water;
  }

  function colour(target, [red, green, blue]) { target.set(red / 255, green / 255, blue / 255); }

  function begin(viewer, water) {
    const background = viewer.backgroundMaterial;
    const Material = background.constructor, Mesh = water.constructor;
    const Geometry = water.geometry.constructor, Vector = water.position.constructor;
    const image = background.uniforms.colorMap.value;
    const Attribute = water.geometry.attributes.position.constructor;
    if (!image) return null;
    const Texture = image.constructor;
    const map = document.createElement("canvas");
    map.width = map.height = MAP_PX;
    const uniforms = {
      xSun: { value: new Vector(0, 1, 0) }, xZenith: { value: new Vector() }, xHaze: { value: new Vector() },
      xGlow: { value: new Vector() }, xWater: { value: new Vector() }, xTime: { value: 0 }, xNight: { value: 0 }, xWind: { value: 3 },
      xFar: { value: 420 }, xMap: { value: [0, 0, 0.02, 1] }, xEastNorth: { value: [1, 0, 0, -1] },
      xRipples: { value: texture(Texture, ripples(), true) }, xWakes: { value: texture(Texture, map, false) },
    };
    const triangle = new Geometry();
    triangle.setAttribute("position", new Attribute(new Float32Array([-1, -1, 0, 3, -1, 0, -1, 3, 0]), 3));
    const sky = new Mesh(triangle, new Material({
      vertexShader: SKY_VERTEX, fragmentShader: SKY_FRAGMENT, uniforms, depthTest: false, depthWrite: false,
    }));
    sky.frustumCulled = false;
    sky.renderOrder = -1000;
    sky.name = "xitl sky";
    sky.raycast = () => {};
    viewer.scene.add(sky);
    const colours = JSON.parse(document.getElementById("xitl-look").textContent);
    return { uniforms, map, context: map.getContext("2d"), sky, colours, drawn: "", Vector };
  }

  function dressWater(material) {
    if (material.userData.xitl) return;
    material.userData.xitl = true;
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, dressing.uniforms);
      shader.fragmentShader = WATER_FRAGMENT;
    };
    material.customProgramCacheKey = () => "xitl water";
    material.needsUpdate = true;
  }

  /* Paint foam (red) and the shade of hulls (blue) around the first vessel, as seen from above. */
  function paintWakes(viewer, nodes, now_s, middle) {
    const { context, uniforms } = dressing;
    const wakes = Object.keys(nodes).filter((name) => name.startsWith("/wakes/") && nodes[name]);
    const longest = wakes.reduce((most, name) => Math.max(most, nodes[name].message.props.points[0] || 0), 1);
    const size_m = 26 * Math.max(Math.min(longest, 60), 1.2), px = MAP_PX / size_m;
    uniforms.xMap.value[2] = 1 / size_m;
    uniforms.xMap.value[3] = Math.max(1 / Math.max(longest / 2, 0.5), 0.04);
    context.globalCompositeOperation = "source-over";
    context.fillStyle = "#000";
    context.fillRect(0, 0, MAP_PX, MAP_PX);
    context.globalCompositeOperation = "lighter";
    const on = (east, north) => [(east - middle[0]) * px + MAP_PX / 2, MAP_PX / 2 - (north - middle[1]) * px];
    for (const name of wakes) {
      const points = nodes[name].message.props.points, length = points[0], beam = points[1];
      const vessel = viewer.nodePoseData[name.replace("/wakes/", "/vessels/")];
      if (!vessel || !vessel.position) continue;
      const [w, x, y, z] = vessel.wxyz;
      const ahead = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z)];
      const way = [];
      for (let at = 3; at + 2 < points.length; at += 3) {
        const age = now_s - points[at + 2];
        if (age > 0.05 && age < LASTS_S) way.push([points[at], points[at + 1], age]);
      }
      way.push([vessel.position[0], vessel.position[1], 0]);
      context.lineCap = "butt";
      let passed = 0;
      for (let at = way.length - 1; at > 0; at -= 1) {
        const [east, north, age] = way[at], [east0, north0, age0] = way[at - 1];
        const step = Math.hypot(east - east0, north - north0), time = Math.max(age0 - age, 1e-3);
        if (step > 20 * length || step < 1e-6) continue;
        const speed = step / time, froude = speed / Math.sqrt(9.81 * length);
        const fresh = Math.exp(-age / (5 + 1.2 * Math.sqrt(length))) * Math.min(froude / 0.35, 1);
        if (fresh < 0.02) break;
        const across = [-(north - north0) / step, (east - east0) / step];
        const stroke = (side, wide, light) => {
          const shift = [side * across[0], side * across[1]];
          context.strokeStyle = `rgb(${Math.round(255 * light)},0,0)`;
          context.lineWidth = Math.max(wide * px, 1);
          context.beginPath();
          context.moveTo(...on(east + shift[0], north + shift[1]));
          context.lineTo(...on(east0 + shift[0] * 1.02, north0 + shift[1] * 1.02));
          context.stroke();
        };
        stroke(0, beam * (0.8 + 0.05 * age), 0.32 * fresh);
        stroke(0, beam * (0.4 + 0.04 * age), 0.25 * fresh);
        const apart = 0.45 * beam + KELVIN * passed;
        for (const side of [-apart, apart]) stroke(side, 0.12 * length + 0.03 * passed, 0.42 * fresh);
        passed += step;
      }
      context.fillStyle = "rgb(0,0,110)";
      for (const grow of [1.0, 1.25]) {
        context.save();
        context.translate(...on(vessel.position[0], vessel.position[1]));
        context.rotate(-Math.atan2(ahead[1], ahead[0]));
        context.beginPath();
        context.ellipse(0, 0, 0.5 * grow * length * px, 0.5 * grow * beam * px, 0, 0, 2 * Math.PI);
        context.fill();
        context.restore();
      }
    }
    uniforms.xWakes.value.needsUpdate = true;
  }

  function dress() {
    const viewer = window.__viserMutable, tree = window.__viserSceneTree;
    const water = waterOf(viewer);
    if (!water || !viewer.backgroundMaterial || !tree) return;
    dressing = dressing || begin(viewer, water);
    if (!dressing) return;
    viewer.backgroundMaterial.uniforms.enabled.value = false;
    dressWater(water.material);
    const { uniforms, Vector } = dressing, nodes = tree.getState();
    const look = viewer.nodePoseData["/look"], sun = viewer.nodePoseData["/light/sun"];
    const water_colour = viewer.nodePoseData["/look/water"];
    if (water_colour && water_colour.position) uniforms.xWater.value.set(...water_colour.position);
    const [time_s, night, wind] = look && look.position ? look.position : [0, 0, 3];
    uniforms.xTime.value = time_s % 3600;
    uniforms.xNight.value = night;
    uniforms.xWind.value = wind;
    const scene = viewer.nodeRefFromName["/water"].parent;
    if (sun && sun.position) {
      const direction = new Vector(...sun.position);
      uniforms.xSun.value.copy(direction.transformDirection(scene.matrixWorld));
    }
    const colours = dressing.colours[night ? "night" : "day"];
    colour(uniforms.xZenith.value, colours.zenith);
    colour(uniforms.xHaze.value, colours.haze);
    colour(uniforms.xGlow.value, colours.glow);
    // Gloss of painted hulls
    for (const [name, node] of Object.entries(viewer.nodeRefFromName)) {
      if (!node || !name.startsWith("/vessels/") || node.userData.xitl) continue;
      node.userData.xitl = true;
      node.traverse((part) => { if (part.isMesh && part.material.isMeshStandardMaterial) part.material.roughness = 0.55; });
    }
    const middle = viewer.nodePoseData["/water"].position;
    const corner = new Vector(middle[0], middle[1], 0).applyMatrix4(scene.matrixWorld);
    uniforms.xMap.value[0] = corner.x;
    uniforms.xMap.value[1] = corner.z;
    const axes = [[1, 0, 0], [0, 1, 0]].map((axis) => new Vector(...axis).transformDirection(scene.matrixWorld));
    uniforms.xEastNorth.value = axes.flatMap((axis) => [axis.x, axis.z]);
    const drawn = `${time_s} ${middle} ${viewer.nodePoseData["/look"] ? "" : performance.now()}`;
    if (drawn !== dressing.drawn) {
      dressing.drawn = drawn;
      paintWakes(viewer, nodes, time_s, middle);
    }
    window.xitlLook = { time_s, water: Boolean(water.material.userData.xitl), sky: dressing.sky.parent !== null };
  }

  function install() {
    const viewer = window.__viserMutable;
    if (viewer && viewer.scene && !viewer.scene.userData.xitl) {
      viewer.scene.userData.xitl = true;
      let failures = 0;
      viewer.scene.onBeforeRender = () => {
        if (failures > 3) return;
        try { dress(); } catch (error) { failures += 1; console.error("xitl look:", error); }
      };
    }
    requestAnimationFrame(install);
  }

  // A processor that draws in place of a graphics card is too slow for the look.
  function isWanted() {
    const asked = new URLSearchParams(location.search).get("look");
    if (asked) return asked === "full";
    const context = document.createElement("canvas").getContext("webgl");
    const info = context && context.getExtension("WEBGL_debug_renderer_info");
    const renderer = info ? context.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
    const end = context && context.getExtension("WEBGL_lose_context");
    if (end) end.loseContext();
    return !/swiftshader|llvmpipe|softpipe|basic render/i.test(renderer);
  }

  if (isWanted()) install();
})();
