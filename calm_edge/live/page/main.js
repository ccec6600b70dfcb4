// Takes the messages of the stream and shows each in its place.
import { listen, request } from "./connection.js";
import { drawFocal } from "./focal.js";
import { drawPicture } from "./picture.js";
import { drawPlan } from "./plan.js";

const at = (id) => document.getElementById(id);
const newest = {};

function count(n) { return Math.round(n).toLocaleString("en"); }

function bytes(n) {
  return n >= 1e12 ? `${(n / 1e12).toFixed(1)} TB` : `${(n / 1e9).toFixed(n < 1e10 ? 1 : 0)} GB`;
}

function unit() { return (newest.drive && newest.drive.unit) || ""; }

function showState(state) {
  at("state").className = state.level;
  at("sentence").textContent = state.text;
  const running = state.recording;
  at("mark").disabled = at("keep").disabled = !running;
}

function showHealth(health) {
  at("word").textContent = health.state;
  if (!health.counts) return;
  const c = health.counts, disk = health.disk;
  at("frames").textContent = `${count(c.primary_frames)} + ${count(c.assistant_frames)}`;
  const lost = Object.entries(health.drops).filter(([, n]) => n > 0);
  at("drops").textContent = lost.length
    ? lost.map(([why, n]) => `${count(n)} ${why.replaceAll("_", " ")}`).join(", ") : "none";
  at("submaps").textContent = `${count(c.submaps)} of ${count(c.windows)} windows`;
  at("age").textContent = health.pose_age_ms === null ? "–" : `${Math.round(health.pose_age_ms)} ms`;
  const free = disk.free_bytes === null ? "free space unknown" : `${bytes(disk.free_bytes)} free`;
  at("disk").textContent = disk.error || [free, health.left].filter(Boolean).join(", ");
  at("celsius").textContent = health.celsius === null ? "no sensor"
    : `${Math.round(health.celsius)} °C${health.throttled ? ", throttled" : ""}`;
  at("keep").setAttribute("aria-pressed", String(disk.kept));
  at("keep").textContent = disk.kept ? "Protected ✓" : "Protect drive";
}

function signed(value) { return (value < 0 ? "−" : "+") + Math.abs(value).toFixed(3); }

function number(value, digits) { return value === null ? "?" : value.toFixed(digits); }

function showKit(kit) {
  const rows = [];
  for (const name of ["primary", "assistant"]) {
    const eye = kit[name];
    if (!eye) continue;
    const row = document.createElement("tr");
    row.className = name;
    const lens = eye.lens
      ? eye.lens.k.map((k, i) => `k${i + 1} ${signed(k)} ± ${eye.lens.sigma[i].toFixed(3)}`)
        .concat(eye.lens.family === "fisheye" ? ["fisheye"] : []).join("\n")
      : "not estimated";
    const focal = `${number(eye.focal_px, 0)} px ± ${number(eye.focal_sigma_percent, 1)} %`;
    for (const text of [name, eye.observed ? focal : `${focal}\nnot observed yet`, lens]) {
      row.append(Object.assign(document.createElement("td"), { textContent: text }));
    }
    rows.push(row);
  }
  at("eyes").replaceChildren(...rows);
  const rig = kit.rig, known = kit.length_sigma_percent;
  const apart = Math.hypot(rig.x, rig.y, rig.z);
  at("rig").textContent = [
    `cameras ${number(apart, 2)} ${unit()} apart, turned ${number(rig.rotation_deg, 1)}°`,
    `assistant ${number(Math.abs(kit.time_offset_ms), 1)} ms ${kit.time_offset_ms < 0 ? "early" : "late"}`,
    unit() === "m" ? (known === null ? "lengths not metric yet" : `lengths ± ${number(known, 1)} %`) : "",
  ].filter(Boolean).join(" · ");
  at("focal").classList.toggle("empty", !kit.history.length);
  drawFocal(at("focal"), kit);
}

function showPlan() {
  const plan = newest.plan || { path: [], points: [], length: 0 }, pose = newest.pose;
  drawPlan(at("plan"), plan, pose, unit());
  at("length").textContent = plan.path.length ? `${plan.length.toFixed(1)} ${unit()}` : "";
  if (!pose) at("pose-note").textContent = "no pose yet";
  else if (pose.x === undefined) at("pose-note").textContent = "the pose is lost";
  else {
    const speed = unit() === "m" && pose.status !== "unscaled" && pose.speed !== null
      ? `${(3.6 * pose.speed).toFixed(0)} km/h` : "";
    const words = { live: "live", lagging: "late: relative to an older sub-map",
      unscaled: "lengths not metric" };
    at("pose-note").textContent = [words[pose.status] || pose.status, speed].filter(Boolean).join(", ");
  }
}

function showList(id, lines) {
  at(id).hidden = !lines.length;
  at(id).replaceChildren(...lines.map(
    (text) => Object.assign(document.createElement("li"), { textContent: text })));
}

function begin() {
  for (const kind of Object.keys(newest)) if (kind !== "drive" && kind !== "state") delete newest[kind];
  showList("events", []);
  showList("notes", []);
  at("word").textContent = "RECORDING";
  showPlan();
}

function showPicture(eye) {
  const picture = newest[eye], masks = newest.masks || {};
  if (!picture) return;
  drawPicture(at(eye), picture, masks[eye]);
  const tracks = (picture.moves || []).length, points = (picture.points || []).length;
  at(`${eye}-note`).textContent = picture.moves ? (tracks ? `${tracks} points tracked` : "no points tracked")
    : picture.points ? `${points} points of the map expected` : "no points tracked";
}

const show = {
  drive: begin,
  state: showState,
  health: showHealth,
  kit: showKit,
  plan: showPlan,
  pose: showPlan,
  primary: () => showPicture("primary"),
  assistant: () => showPicture("assistant"),
  masks: () => { showPicture("primary"); showPicture("assistant"); },
  notes: ({ notes }) => showList("notes", notes.slice().reverse()),
  events: ({ events }) => showList("events", events.map((e) =>
    `${new Date(1000 * e.unix_s).toLocaleTimeString()}${e.text ? ` ${e.text}` : ""}`).reverse()),
  end: () => {},
};

function lost(text) {
  showState({ level: "bad", text, recording: false });
  at("word").textContent = "NO CONNECTION";
}

async function press(kind, content, done) {
  at("answer").textContent = await request(kind, content) || done;
  clearTimeout(press.timer);
  press.timer = setTimeout(() => { at("answer").textContent = ""; }, 6000);
}

at("mark").onclick = () => press("event", { text: "" }, "Event marked.");
at("keep").onclick = () => {
  const kept = at("keep").getAttribute("aria-pressed") !== "true";
  press("keep", { kept }, kept ? "This drive will not be deleted." : "No longer protected.");
};
addEventListener("resize", () => { showPlan(); if (newest.kit) showKit(newest.kit); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  showPlan();
  if (newest.kit) showKit(newest.kit);
});
showPlan();
const takes = Object.entries(show).map(([kind, action]) => [kind, (content) => {
  newest[kind] = content;
  action(content);
}]);
listen(Object.fromEntries(takes), "calm-edge live", lost);
