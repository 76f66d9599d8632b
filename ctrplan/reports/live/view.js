// Moves the robot of the live view: every change of a slider asks the server for a pose, one request at a time.
"use strict";

const byId = (id) => document.getElementById(id);
const values = JOINTS.map((joint) => joint.value);
const inputs = [];
let busy = false, stale = false, largest = 5;

function row(joint, k) {
  const label = document.createElement("label"), text = document.createElement("span");
  text.textContent = `${joint.name} (${joint.unit})`;
  const number = Object.assign(document.createElement("input"), {type: "number", step: "any"});
  const range = Object.assign(document.createElement("input"), {type: "range", min: joint.min, max: joint.max, step: "any"});
  range.setAttribute("aria-label", joint.name);
  range.addEventListener("input", () => change(k, range.valueAsNumber));
  number.addEventListener("change", () => { if (Number.isFinite(number.valueAsNumber)) change(k, number.valueAsNumber); });
  label.append(text, number, range);
  inputs.push({number, range});
  return label;
}

function change(k, value) {
  values[k] = value;
  show();
  update();
}

function show() {
  inputs.forEach(({number, range}, k) => {
    range.value = values[k];
    number.value = (Math.round(values[k] * 100) / 100).toString();
  });
  byId("toml").textContent = JOINTS.map((joint, k) => `"${joint.name}" = ${Number(values[k].toFixed(3))}`).join("\n");
}

async function update() {
  if (busy) { stale = true; return; }
  busy = true;
  try {
    const answer = await fetch("pose?q=" + values.map((value) => value.toFixed(6)).join(","));
    const pose = await answer.json();
    if (pose.traces) await draw(pose);
    say(pose);
  } catch (error) {
    say({refusal: "the program behind this page has ended"});
  }
  busy = false;
  if (stale) { stale = false; update(); }
}

function draw(pose) {
  const indices = pose.traces.map((_, k) => k);
  const change = {x: pose.traces.map((t) => t.x), y: pose.traces.map((t) => t.y), z: pose.traces.map((t) => t.z)};
  return Plotly.restyle("scene", change, indices);
}

const shown = (value, digits, unit) => value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`.trim();

function say(pose) {
  const state = byId("state"), wrong = pose.refusal || pose.reason;
  state.className = wrong ? "bad" : "good";
  state.textContent = wrong ? wrong.charAt(0).toUpperCase() + wrong.slice(1) : "Keeps all limits and margins";
  document.body.dataset.updates = Number(document.body.dataset.updates || 0) + 1;
  byId("bound").textContent = shown(pose.refusal ? null : pose.bound_mm, 2, "mm");
  largest = Math.max(largest, pose.bound_mm || 0);
  byId("meter").firstElementChild.style.width = `${100 * (pose.bound_mm || 0) / largest}%`;
  byId("bound_deg").textContent = shown(pose.bound_deg, 2, "°");
  byId("stability").textContent = shown(pose.stability, 2, "");
  byId("strain_percent").textContent = shown(pose.strain_percent, 2, "%");
  byId("clearance_mm").textContent = pose.refusal ? "–" : pose.clearance_mm === null ? "free space" : shown(pose.clearance_mm, 2, "mm");
  byId("tip_mm").textContent = pose.tip_mm ? pose.tip_mm.map((x) => x.toFixed(1)).join(", ") + " mm" : "–";
}

byId("joints").append(...JOINTS.map(row));
byId("reset").addEventListener("click", () => { JOINTS.forEach((joint, k) => { values[k] = joint.value; }); show(); update(); });
FIGURE.layout.height = undefined;
FIGURE.layout.autosize = true;
FIGURE.layout.margin = {l: 0, r: 0, t: 0, b: 0};
FIGURE.layout.scene.domain = {x: [0, 1], y: [0, 1]};
const buttons = [["toImage", "resetCameraDefault3d"]];
Plotly.newPlot("scene", FIGURE.data, FIGURE.layout, {displaylogo: false, responsive: true, modeBarButtons: buttons})
  .then(() => { show(); return update(); });
