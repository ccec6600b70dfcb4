const canvas = document.getElementById("map");
const gl = canvas.getContext("webgl2", {antialias: false, alpha: false, preserveDrawingBuffer: true});
const COARSE = matchMedia("(pointer: coarse)").matches;
// points in memory, 24 bytes each on both sides; a phone has less of it
const MOST = COARSE ? 2_000_000 : 12_000_000;
const COLORS = ["picture", "height", "sub-map", "age"];
// lower and upper corner of the path
const CORNERS = [Math.min, Math.max].map((edge) => DRIVE.path.reduce((c, p) => c.map((v, a) => edge(v, p[a]))));
const EXTENT = distance(...CORNERS) || 1;

function start() {
  const points = new Points(gl, DRIVE, MOST);
  const path = new Lines(gl), stops = new Lines(gl), here = new Lines(gl), ruler = new Lines(gl);
  const marks = new Lines(gl);
  const seams = new Seams(gl);
  const firsts = new Set(DRIVE.drives.map(([, k]) => k));
  path.set(DRIVE.path.slice(1).map((p, i) => [DRIVE.path[i], p]).filter((_, i) => !firsts.has(i + 1)));
  stops.set(DRIVE.path.map((p) => [p, p]));
  marks.set(DRIVE.events.map(([k]) => [DRIVE.path[k], DRIVE.path[k]]));
  const began = performance.now(), stats = {firstPicture: null, frames: 0, drawn: 0, loaded: 0};
  let view = initial(), colors = 0, moved = true, drawn = 0, budget = COARSE ? 150_000 : 250_000;
  let last = 0, measuring = null, keyframe = 0, waiting = 0, complaint = "", hashTimer = 0;

  function overview() {
    const middle = CORNERS[0].map((v, a) => (v + CORNERS[1][a]) / 2);
    const wide = Math.tan(View.FOV / 2) * Math.min(1.6, canvas.clientWidth / canvas.clientHeight);
    return new View(middle, -Math.PI / 2, 0.75, 0.6 * EXTENT / wide + 20 * DRIVE.grain);
  }

  function behind(k) {
    const away = Math.min(0.35 * EXTENT + 20 * DRIVE.grain, 200 * DRIVE.grain);
    const yaw = DRIVE.heading[k] + Math.PI;
    const ahead = [Math.cos(DRIVE.heading[k]), Math.sin(DRIVE.heading[k]), 0];
    return new View(add(DRIVE.path[k], ahead, 0.4 * away), yaw, 0.32, away);
  }

  function initial() {
    const address = new URLSearchParams(location.hash.slice(1));
    return View.fromText(address.get("v")) || overview();
  }

  function fromAddress() {
    const address = new URLSearchParams(location.hash.slice(1));
    const k = Number(address.get("k")) - 1;
    // an address with a keyframe alone, such as of the report's events, leads to it
    view = View.fromText(address.get("v")) || (address.has("k") && DRIVE.path[k] ? behind(k) : view);
    colors = Math.max(0, COLORS.indexOf(address.get("c")));
    panel.element.colors.selectedIndex = colors;
    showSeams(address.get("s") === "1");
    if (address.has("k") && DRIVE.path[k]) mark(k);
    redraw();
  }

  function toAddress() {
    const text = `#v=${view.toText()}&c=${COLORS[colors]}&k=${keyframe + 1}${seams.wanted ? "&s=1" : ""}`;
    try { history.replaceState(null, "", text); } catch { location.hash = text; }
  }

  function redraw() {
    moved = true;
    clearTimeout(hashTimer);
    hashTimer = setTimeout(toAddress, 250);
    if (!waiting) waiting = requestAnimationFrame(frame);
  }

  function mark(k) {
    keyframe = k;
    here.set([[DRIVE.path[k], DRIVE.path[k]]]);
    panel.place(k);
    panel.show(k);
  }

  function clip() { return view.matrix(canvas.width / canvas.height); }

  /** Draw as many points as a frame allows; while nothing moves, the next ones are added to them. */
  function frame(now) {
    waiting = 0;
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.round(v * scale));
    if (canvas.width !== width || canvas.height !== height) {
      Object.assign(canvas, {width, height});
      moved = true;
    }
    const pause = now - last;
    last = now;
    if (pause > 0 && pause < 500) {
      // 30 frames a second while it moves
      if (pause > 34) budget = Math.max(30_000, budget * 0.85);
      else if (pause < 25) budget = Math.min(points.room, budget * 1.1);
    }
    gl.viewport(0, 0, width, height);
    const matrix = clip(), pixels = height / (2 * Math.tan(View.FOV / 2));
    if (moved) {
      gl.clearColor(...ink("--sky"), 1);
      gl.enable(gl.DEPTH_TEST);
      gl.depthFunc(gl.LEQUAL); // lines have one depth: the last drawn is on top
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      drawn = 0;
      path.draw(matrix, [width, height], ink("--estimate"), 2 * scale);
      stops.draw(matrix, [width, height], ink("--estimate"), 4.5 * scale);
      seams.draw(matrix, 3 * scale);
      marks.draw(matrix, [width, height], ink("--bad"), 8 * scale);
      here.draw(matrix, [width, height], ink("--truth"), 11 * scale);
      ruler.draw(matrix, [width, height], ink("--bad"), 3 * scale);
      label(matrix);
      moved = false;
    }
    const count = Math.min(Math.round(budget), points.loaded - drawn);
    if (count > 0) points.draw(matrix, pixels, colors, drawn, count);
    drawn += Math.max(0, count);
    Object.assign(stats, {frames: stats.frames + 1, drawn, loaded: points.loaded, budget});
    if (stats.firstPicture === null && drawn) stats.firstPicture = performance.now();
    if (drawn < points.loaded && !waiting) waiting = requestAnimationFrame(frame);
    if (!measuring) tell();
  }

  function tell() {
    const n = (v) => v.toLocaleString("en");
    const rest = points.room < DRIVE.count ? ` (of ${n(DRIVE.count)}, as this device allows)` : "";
    if (seams.shown && !complaint) return panel.say(seams.text(DRIVE.unit));
    panel.say(complaint || `${n(points.loaded)} points${rest}`);
  }

  /** Write the measured length beside the line. */
  function label(matrix) {
    const tag = panel.element.length, ends = measuring || [];
    tag.hidden = ends.length < 2;
    if (tag.hidden) return;
    const middle = ends[0].map((v, a) => (v + ends[1][a]) / 2);
    const at = onScreen(matrix, canvas.clientWidth, canvas.clientHeight, middle);
    tag.hidden = !at;
    if (!at) return;
    tag.textContent = `${distance(...ends).toPrecision(3)} ${DRIVE.unit}`;
    tag.style.transform = `translate(${at[0] + 8}px, ${at[1] + 8}px)`;
  }

  function measureAt(x, y) {
    const p = points.pick(clip(), canvas.clientWidth, canvas.clientHeight, x, y, COARSE ? 12 : 6);
    if (!p) return panel.say("No point there; choose another.");
    measuring = measuring.length === 1 ? [measuring[0], p] : [p];
    ruler.set(measuring.length === 1 ? [[p, p]] : [measuring]);
    panel.say(measuring.length === 1 ? "Now the second point."
      : `${distance(...measuring).toPrecision(3)} ${DRIVE.unit} apart. Choose a first point for another.`);
    redraw();
  }

  function click(x, y) {
    if (measuring) return measureAt(x, y);
    const matrix = clip();
    let best = -1, least = COARSE ? 28 : 16;
    DRIVE.path.forEach((p, k) => {
      const s = onScreen(matrix, canvas.clientWidth, canvas.clientHeight, p);
      const d = s ? Math.hypot(s[0] - x, s[1] - y) : Infinity;
      if (d < least) { best = k; least = d; }
    });
    if (best >= 0) { mark(best); redraw(); }
  }

  const panel = new Panel(DRIVE, {
    jump: (k) => { view = behind(k); mark(k); redraw(); },
    colors: (k) => { colors = k; redraw(); },
    whole: () => { view = overview(); redraw(); },
    seams: () => { showSeams(!seams.shown); redraw(); },
    measure: () => {
      measuring = measuring ? null : [];
      panel.element.measure.setAttribute("aria-pressed", String(Boolean(measuring)));
      ruler.set([]);
      if (measuring) panel.say("Choose the first point.");
      redraw();
    },
  });
  function showSeams(shown) {
    seams.wanted = shown; // also before they are read
    seams.shown = shown && seams.count > 0;
    panel.element.seams.setAttribute("aria-pressed", String(seams.shown));
  }

  new Pointer(canvas, {
    orbit: (dx, dy) => { view.orbit(dx, dy); redraw(); },
    pan: (dx, dy) => { view.pan(dx, dy); redraw(); },
    zoom: (factor) => { view.zoom(factor, 5 * DRIVE.grain, 20 * EXTENT + 500 * DRIVE.grain); redraw(); },
    click,
  });

  const inks = new Map();
  function ink(name) {
    if (!inks.has(name)) {
      const hex = getComputedStyle(document.documentElement).getPropertyValue(name).trim().slice(1);
      inks.set(name, [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255));
    }
    return inks.get(name);
  }

  /** Load the files beside the page one after the other. */
  function loadFiles([name, ...others]) {
    if (!name || points.loaded >= points.room) return;
    const script = document.createElement("script");
    script.src = name;
    script.onload = () => { script.remove(); loadFiles(others); };
    script.onerror = () => {
      complaint = `${name} is not beside this page: ${points.loaded.toLocaleString("en")} of `
        + `${DRIVE.count.toLocaleString("en")} points are shown. Copy the folder with the page.`;
      tell();
    };
    document.head.append(script);
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { inks.clear(); redraw(); });
  addEventListener("resize", redraw);
  addEventListener("hashchange", fromAddress);
  canvas.addEventListener("webglcontextlost", (e) => e.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => location.reload());
  window.calmEdgeMap = {
    stats,
    points: (text) => {
      if (points.loaded < points.room) points.add(text);
      last = -Infinity; // reading is not what a frame takes
      redraw();
    },
    pictures: (rows) => {
      for (const [k, ...rest] of rows) panel.pictures.set(k, rest);
    },
    seams: (text) => {
      seams.set(text);
      panel.element.seams.hidden = false;
      showSeams(seams.wanted);
      redraw();
    },
    end: () => {
      if (panel.shown !== null) panel.show(panel.shown);
      loadFiles(DRIVE.files);
    },
    // of a point: where it is on the screen; for tests
    pixelOf: (p) => onScreen(clip(), canvas.clientWidth, canvas.clientHeight, p),
    began,
  };
  fromAddress();
}

if (gl) start();
else {
  document.getElementById("status").textContent =
    "This browser has no WebGL2, which the map needs: open the page in a newer one, or switch on "
    + "graphics acceleration in its settings.";
  window.calmEdgeMap = {points() {}, pictures() {}, seams() {}, end() {}, stats: null};
}
