// Moves the robot of the live view: every change of a slider asks the server for a pose, one request at a time.
"use strict";

const LONGEST_WAIT_MS = 60000, NOTICEABLE_MS = 400;
const byId = (id) => document.getElementById(id);
const values = JOINTS.map((joint) => joint.value);
const inputs = [];
const moves = Array.from(document.querySelectorAll("#base input"));
let busy = false, stale = false, largest = 5, base = "[base]", playing = null;

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
  toml();
}

function toml() {
  byId("toml").textContent = `${base}\n[start]\n` + JOINTS.map((joint, k) => `"${joint.name}" = ${Number(values[k].toFixed(3))}`).join("\n");
}

async function update() {
  if (busy) { stale = true; return; }
  busy = true;
  const waiting = setTimeout(() => tell("quiet", "Solving this pose ..."), NOTICEABLE_MS);
  const pose = await asked();
  clearTimeout(waiting);
  if (pose.base) { base = pose.base; toml(); }
  if (pose.traces) await draw(pose);
  say(pose);
  busy = false;
  if (stale) { stale = false; update(); }
}

// The pose, or {refusal: why there is none}; whatever fails must not leave the figures of another pose on the page.
async function asked(what = "pose", more = "") {
  const listed = (numbers) => encodeURIComponent(numbers.map((value) => value.toFixed(6)).join(","));
  const query = `q=${listed(values)}&base=${listed(moves.map((input) => input.valueAsNumber || 0))}${more}`;
  let answer;
  try {
    answer = await fetch(`${what}?${query}`, {signal: AbortSignal.timeout(LONGEST_WAIT_MS)});
  } catch (error) {
    const late = error.name === "TimeoutError";
    return {refusal: late ? `no answer within ${LONGEST_WAIT_MS / 1000} s` : "the program behind this page has ended"};
  }
  try {
    const pose = await answer.json();
    if (answer.ok && (pose.refusal || pose.traces || pose.joints)) return pose;
    return {refusal: pose.error || `the program answered ${answer.status}`};
  } catch (error) {
    return {refusal: "the program's answer could not be read"};
  }
}

// The tip to a point of the anatomy's frame [mm], by inverse kinematics.
async function reachFor(point) {
  document.querySelectorAll("#pick input").forEach((input, k) => { input.value = Number(point[k].toFixed(3)); });
  tell("quiet", "Looking for joint values ...");
  const found = await asked("ik", `&tip=${encodeURIComponent(point.join(","))}`);
  if (!found.joints) { tell("bad", found.refusal); return; }
  found.joints.forEach((value, k) => { values[k] = value; });
  show();
  update();
}

function addMotion() {
  if (!MOTION) return;
  const slider = byId("time"), play = byId("play"), last = MOTION.time_s.length - 1;
  const at = (k) => {
    slider.value = k;
    byId("now").textContent = `${MOTION.time_s[k].toFixed(1)} s`;
    MOTION.joints[k].forEach((value, n) => { values[n] = value; });
    show();
    update();
  };
  const stop = () => { clearInterval(playing); playing = null; play.textContent = "▶"; };
  const began = () => ({clock: performance.now(), time: MOTION.time_s[Number(slider.value) % last]});
  byId("player").hidden = false;
  slider.max = last;
  byId("now").textContent = "0.0 s";
  slider.addEventListener("input", () => { stop(); at(Number(slider.value)); });
  play.addEventListener("click", () => {
    if (playing) { stop(); return; }
    const start = began();
    play.textContent = "❚❚";
    playing = setInterval(() => {  // in real time, as many poses as are solved
      const now = start.time + (performance.now() - start.clock) / 1000;
      const k = MOTION.time_s.findIndex((time) => time >= now);
      if (!busy) at(k < 0 ? last : k);
      if (k < 0) stop();
    }, 60);
  });
}

async function draw(pose) {
  const columns = (axis) => pose.traces.map((trace) => trace[axis]);
  await Plotly.restyle("scene", {x: columns("x"), y: columns("y"), z: columns("z")}, pose.traces.map((_, k) => k));
  await makeRoom(pose.traces);
}

// Axes cut off what is beyond them: they grow with the robot, and never shrink.
function makeRoom(traces) {
  const plot = byId("scene"), change = {}, extent = {};
  for (const axis of ["x", "y", "z"]) {
    const [low, high] = plot.layout.scene[`${axis}axis`].range;
    const seen = traces.flatMap((trace) => trace[axis]).filter((value) => value !== null);
    const range = [Math.min(low, ...seen), Math.max(high, ...seen)];
    if (range[0] < low || range[1] > high) change[`scene.${axis}axis.range`] = range;
    extent[axis] = range[1] - range[0];
  }
  if (!Object.keys(change).length) return null;
  const size = Math.cbrt(extent.x * extent.y * extent.z);
  change["scene.aspectratio"] = {x: extent.x / size, y: extent.y / size, z: extent.z / size};
  return Plotly.relayout(plot, change).then(() => fitCamera(plot));
}

const shown = (value, digits, unit) => value === null || value === undefined ? "–" : `${value.toFixed(digits)} ${unit}`.trim();

function tell(kind, sentence) {
  byId("state").className = kind;
  byId("state").textContent = sentence.charAt(0).toUpperCase() + sentence.slice(1);
}

function say(pose) {
  const wrong = pose.refusal || pose.reason || (pose.valid ? "" : "does not keep all limits and margins");
  tell(wrong ? "bad" : "good", wrong || "Keeps all limits and margins");
  document.body.dataset.updates = Number(document.body.dataset.updates || 0) + 1;
  byId("bound").textContent = shown(pose.refusal ? null : pose.bound_mm, 2, "mm");
  largest = Math.max(largest, pose.bound_mm || 0);
  byId("meter").firstElementChild.style.width = `${100 * (pose.bound_mm || 0) / largest}%`;
  byId("bound_deg").textContent = shown(pose.bound_deg, 2, "°");
  byId("stability").textContent = shown(pose.stability, 2, "");
  byId("other_shape").parentElement.hidden = !pose.other_shape_mm;
  byId("other_shape").textContent = `${shown(pose.other_shape_mm, 1, "mm")} away`;
  byId("strain_percent").textContent = shown(pose.strain_percent, 2, "%");
  for (const name of ["nominal_mm", "friction_mm", "sure_mm"])
    byId(name).textContent = pose.refusal ? "–" : pose[name] === null ? "free space" : shown(pose[name], 2, "mm");
  fromTarget(pose.refusal ? null : pose.target);
  byId("tip_mm").textContent = pose.tip_mm ? pose.tip_mm.map((x) => x.toFixed(1)).join(", ") + " mm" : "–";
}

// Amber where the tip would be there without friction, and need not be with it.
function fromTarget(target) {
  for (const [name, key] of [["target_free", "free_mm"], ["target_worst", "worst_mm"]]) {
    byId(name).parentElement.hidden = !target;
    if (target) byId(name).textContent = shown(target[key], 2, "mm");
  }
  const there = target && target.free_mm <= target.tolerance_mm;
  byId("target_worst").className = there ? (target.exceeds ? "caution" : "good") : "";
  if (target) byId("target_worst").textContent += ` (tolerance ${target.tolerance_mm.toFixed(2)} mm)`;
}

byId("joints").append(...JOINTS.map(row));
byId("reset").addEventListener("click", () => { JOINTS.forEach((joint, k) => { values[k] = joint.value; }); moves.forEach((input) => { input.value = 0; }); show(); update(); });
moves.forEach((input) => input.addEventListener("change", update));
byId("pick").addEventListener("submit", (event) => {
  event.preventDefault();
  reachFor(Array.from(document.querySelectorAll("#pick input"), (input) => input.valueAsNumber));
});
const buttons = [["toImage"]];
Plotly.newPlot("scene", FIGURE.data, FIGURE.layout, {displaylogo: false, responsive: true, modeBarButtons: buttons})
  .then((plot) => {
    plot.on("plotly_click", ({points: [point]}) => { if (point && point.data.meta && point.data.meta.target) reachFor([point.x, point.y, point.z]); });
    addMotion();
    show(); addKey(plot, byId("key")); return keepFitted(plot); }).then(update);
