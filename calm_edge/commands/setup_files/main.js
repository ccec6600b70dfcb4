// Shows the state of the set-up, and sends what is chosen.
import { listen, request } from "./connection.js";

const at = (id) => document.getElementById(id);
const EYES = ["primary", "assistant"];
const WORDS = { good: "ok", warning: "note", bad: "fails" };
let state = null, ended = false;

function made(name, content) { return Object.assign(document.createElement(name), content); }

function showLights(id, lights, none) {
  const items = lights.map((light) => {
    const item = made("li", { className: light.level });
    const text = made("span", {});
    text.append(made("b", { textContent: light.name }),
      `: ${light.text}${light.level === "good" ? "" : ` (${WORDS[light.level]})`}`);
    item.append(made("i", { ariaHidden: "true" }), text);
    if (light.remedy) item.append(made("small", { textContent: `→ ${light.remedy}` }));
    return item;
  });
  at(id).replaceChildren(...(items.length ? items : [made("li", { className: "note", textContent: none })]));
}

// what somebody types at present stays
function fill(input, value) {
  if (document.activeElement !== input && input.getAttribute("aria-invalid") !== "true") input.value = value;
}

function showPair(now) {
  const choosable = now.cameras.length >= 2;
  at("pair").hidden = !choosable;
  at("swap").disabled = at("cover").disabled = !choosable || now.busy || ended;
  for (const eye of EYES) {
    const select = at(`choose-${eye}`);
    if (document.activeElement !== select) {
      select.replaceChildren(...now.cameras.map((camera) => made("option",
        { value: camera.address, textContent: `${camera.address} (${camera.name})` })));
    }
    if (now.chosen) select.value = now[eye];
    select.disabled = now.busy || ended;
    if (now.chosen) at(`${eye}-note`).textContent = now[eye];
  }
}

function showState(now) {
  state = now;
  ended = now.ended;
  at("state").className = now.level;
  at("sentence").textContent = now.sentence;
  showPair(now);
  showLights("lights", now.lights, "not checked yet");
  showLights("ports", now.ports, "");
  showLights("speed-light", now.speed ? [now.speed] : [], "not measured yet");
  fill(at("spacing"), now.spacing_m ? `${now.spacing_m} m` : "");
  if (at("spacing").getAttribute("aria-invalid") !== "true") {
    at("spacing-note").textContent = now.spacing_m
      ? "" : "Without it lengths are not in metres. From the middle of one lens to that of the other.";
  }
  fill(at("port"), now.port);
  fill(at("gps"), now.gps);
  at("devices").replaceChildren(...now.devices.map((path) => made("option", { value: path })));
  at("path").textContent = now.objection ? `Cannot be written: ${now.objection}`
    : now.keys.length ? `${now.path} gets:`
      : now.written ? `${now.path} is written.` : `Nothing in ${now.path} has to change.`;
  at("keys").textContent = now.keys.join("\n");
  at("record").textContent = now.written ? `To record: ${now.record}` : "";
  at("write").textContent = `Write ${now.path.split("/").pop()}`;
  at("write").disabled = ended || now.busy || Boolean(now.objection) || (now.written && !now.keys.length);
  at("start").hidden = !now.startable;
  at("start").disabled = ended || now.busy || !now.written;
  at("finish").disabled = ended;
  at("speed").disabled = ended || now.busy;
  for (const id of ["spacing", "port", "gps"]) at(id).disabled = ended;
  if (now.notice) answer(now.notice);
}

function showPicture(eye, picture) {
  at(eye).src = picture.src;
  at(eye).alt = `${eye} camera`;
  if (!state || !state.chosen) at(`${eye}-note`).textContent = "";
}

function answer(text) { at("answer").textContent = text; }

async function press(kind, content, done = "") { answer(await request(kind, content) || done); }

// a value that is refused stays to be mended, with the reason
async function change(ids, kind, content) {
  const objection = await request(kind, content);
  for (const id of ids) at(id).setAttribute("aria-invalid", String(Boolean(objection)));
  if (kind === "spacing") at("spacing-note").textContent = objection;
  answer(objection);
  return objection;
}

function sendSpacing() { return change(["spacing"], "spacing", { text: at("spacing").value }); }

function sendPorts() {
  return change(["port", "gps"], "ports", { port: at("port").value, gps: at("gps").value });
}

for (const eye of EYES) {
  at(`choose-${eye}`).onchange = () => {
    const other = EYES.find((name) => name !== eye), chosen = at(`choose-${eye}`).value;
    // the one that was chosen for the other eye takes its place
    const pair = { [eye]: chosen, [other]: chosen === state[other] ? state[eye] : state[other] };
    at(`choose-${eye}`).blur();
    press("pair", pair);
  };
}
at("swap").onclick = () => press("pair", { primary: state.assistant, assistant: state.primary });
at("cover").onclick = () => press("cover", {});
at("spacing").onchange = sendSpacing;
at("port").onchange = at("gps").onchange = sendPorts;
at("speed").onclick = () => press("speed", {});
at("write").onclick = () => press("write", {}, "Written.");
at("start").onclick = () => press("start", {});
at("finish").onclick = () => {
  const unwritten = state && !state.written;
  if (!unwritten || confirm("Nothing was written yet. End the set-up?")) press("finish", {});
};

function lost(text) {
  if (ended) return;
  at("state").className = "bad";
  at("sentence").textContent = text;
}

listen({
  setup: showState,
  primary: (picture) => showPicture("primary", picture),
  assistant: (picture) => showPicture("assistant", picture),
}, "calm-edge setup", lost);
