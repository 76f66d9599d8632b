// Where the report's scene is looked at from, and what of the anatomy is cut away so that one sees into it.
"use strict";

const BESIDE_MM = 45, LAMP_MM = 40, WALL = [[0, "#0d0506"], [0.5, "#8d4a41"], [1, "#f0b3a4"]];
const LAMP = {cmin: 0, cmax: 1, showscale: false, "lighting.ambient": 1, "lighting.diffuse": 0, "lighting.specular": 0};
const ROBOT = ["tube", "envelope", "corner"];
const HIDES = {Inside: [...ROBOT, "robot at", "space the", "closest", "front plate", "axes"], Closest: ROBOT}, SHOWS = {Closest: ["closest"]};
const MEANS = {
  All: "the whole motion, as large as the window is",
  Plate: "along the robot, from where the drive stands",
  Target: "beside the target",
  Closest: "where friction brings the robot nearest to the anatomy, at that moment",
  Inside: "from the tip along its path, as a camera there would see the lumen",
};

function addLooking(plot, views) {
  const bar = document.getElementById("looking"), frame = () => Number((document.getElementById("time") || {value: 0}).value);
  const cut = addCut(plot), usual = plot.data.map((trace) => trace.visible);
  const walls = indices(plot, (trace) => trace.meta && trace.meta.wall);
  const day = walls.map((k) => ({...plot.data[k].lighting}));
  let way = "All";

  const places = {
    "All": () => ({fit: true}),
    "Plate": () => ({eye: add(views.base, views.axis, -2.2 * BESIDE_MM, views.side, 0.9 * BESIDE_MM), at: add(views.base, views.axis, 0.4 * BESIDE_MM)}),
    "Target": () => ({eye: add(views.goal, views.side, 1.6 * BESIDE_MM), at: views.goal}),
    "Closest": () => ({eye: add(views.closest, views.closest_side, 0.8 * BESIDE_MM), at: views.closest, frame: views.closest_frame}),
    "Inside": () => ({eye: views.tips[frame()], at: add(views.tips[frame()], views.along[frame()], BESIDE_MM)}),
  };
  for (const [name, place] of Object.entries(places)) {
    if ((name === "Closest" && !views.closest) || (name === "Inside" && !views.inside)) continue;
    const button = Object.assign(document.createElement("button"), {type: "button", textContent: name, title: MEANS[name]});
    button.addEventListener("click", () => look(name, place));
    bar.append(button);
  }
  bar.append(cut);

  async function look(name, place) {
    await enter(name);
    const {eye, at, fit, frame: moment} = place();
    if (moment !== undefined) setTime(moment);
    if (fit) return fitCamera(plot, true);
    return aim(eye, at);
  }

  async function aim(eye, at) {
    if (way === "Inside") await light(eye);
    const up = Math.abs(unit(minus(at, eye)).z) > 0.95 ? {x: 1, y: 0, z: 0} : {x: 0, y: 0, z: 1};
    return Plotly.relayout(plot, {"scene.camera": {eye: toScene(plot, eye), center: toScene(plot, at), up}});
  }

  // Light from the eye, which plotly's own lamps do not give: near walls that face it are bright, far ones dark.
  function light(eye) {
    const shades = walls.map((k) => lit(plot._fullData[k], eye));
    return walls.length ? Plotly.restyle(plot, {intensity: shades}, walls) : null;
  }

  async function enter(name) {
    if (name === way) return;
    const before = way, begins = (trace, starts) => (starts || []).some((start) => (trace.name || "").startsWith(start));
    const own = !HIDES[before];  // what the reader shows and hides is kept, views with parts of their own aside
    if (own) plot.data.forEach((trace, k) => { usual[k] = trace.visible; });
    way = name;
    const visible = plot.data.map((trace, k) => begins(trace, SHOWS[name]) || (!begins(trace, HIDES[name]) && (usual[k] === undefined || usual[k])));
    if (!own || HIDES[name]) await Plotly.restyle(plot, {visible: visible});
    if ((before === "Inside") === (name === "Inside")) return;
    const within = name === "Inside", colours = walls.map((k) => [[0, plot.data[k].color], [1, plot.data[k].color]]);  // plotly keeps what was lit before
    const lamps = Object.fromEntries(["ambient", "diffuse", "specular"].map((kind) => [`lighting.${kind}`, day.map((light) => light[kind])]));
    const change = {opacity: walls.map((k) => (within ? 1 : plot.data[k].meta.wall)), colorscale: within ? walls.map(() => WALL) : colours, ...(within ? LAMP : lamps)};
    if (walls.length) await Plotly.restyle(plot, change, walls);
  }

  function setTime(k) {
    const slider = document.getElementById("time");
    if (slider) { slider.value = k; slider.dispatchEvent(new Event("input")); }
  }

  const slider = document.getElementById("time");
  plot.addEventListener("moved", () => { if (way === "Inside" && slider) aim(places.Inside().eye, places.Inside().at); });
}

// A choice of side and a slider: what is beyond the plane of the anatomy is not drawn.
function addCut(plot) {
  const label = Object.assign(document.createElement("label"), {className: "cut"});
  const side = document.createElement("select"), where = document.createElement("input");
  const names = ["nothing", "x above", "x below", "y above", "y below", "z above", "z below"];
  side.append(...names.map((name) => Object.assign(document.createElement("option"), {textContent: name})));
  side.id = "cut";
  Object.assign(where, {type: "range", min: 0, max: 1, step: 0.01, value: 0.5, id: "cut-at"});
  where.setAttribute("aria-label", "where the anatomy is cut");
  label.append("Cut away ", side, where);
  const which = indices(plot, (trace) => trace.meta && trace.meta.cut);
  const whole = new Map(which.map((k) => [k, copied(plot._fullData[k])]));
  const change = () => {
    const axis = "xyz"["xyz".indexOf(side.value[0])], [low, high] = axis ? plot.layout.scene[`${axis}axis`].range : [0, 0];
    const at = low + Number(where.value) * (high - low), sign = side.value.endsWith("above") ? 1 : -1;
    const left = which.map((k) => (axis ? halved(whole.get(k), axis, at, sign) : whole.get(k)));
    const columns = Object.fromEntries(["x", "y", "z", "i", "j", "k"].map((name) => [name, left.map((mesh) => mesh[name])]));
    where.disabled = !axis;
    return Plotly.restyle(plot, columns, which);
  };
  where.disabled = true;
  side.addEventListener("change", change);
  where.addEventListener("input", change);
  return label;
}

function copied(trace) {
  return Object.fromEntries(["x", "y", "z", "i", "j", "k"].map((name) => [name, Array.from(trace[name])]));
}

// The part of a mesh with sign * (axis - at) <= 0; triangles across the plane are cut through.
function halved(mesh, axis, at, sign) {
  const kept = {x: mesh.x.slice(), y: mesh.y.slice(), z: mesh.z.slice(), i: [], j: [], k: []};
  const beyond = mesh[axis].map((value) => sign * (value - at)), crossings = new Map();
  const corner = (a, b) => {
    const key = a < b ? `${a},${b}` : `${b},${a}`;
    if (!crossings.has(key)) {
      const share = beyond[a] / (beyond[a] - beyond[b]);
      crossings.set(key, kept.x.length);
      for (const name of ["x", "y", "z"]) kept[name].push(mesh[name][a] + share * (mesh[name][b] - mesh[name][a]));
    }
    return crossings.get(key);
  };
  const add3 = (a, b, c) => { kept.i.push(a); kept.j.push(b); kept.k.push(c); };
  for (let t = 0; t < mesh.i.length; t++) {
    const around = [mesh.i[t], mesh.j[t], mesh.k[t]], outline = [];
    around.forEach((a, n) => {
      const b = around[(n + 1) % 3];
      if (beyond[a] <= 0) outline.push(a);
      if (beyond[a] <= 0 !== beyond[b] <= 0) outline.push(corner(a, b));
    });
    for (let n = 1; n + 1 < outline.length; n++) add3(outline[0], outline[n], outline[n + 1]);
  }
  if (!kept.i.length) add3(0, 0, 0);  // a mesh without triangles would be wrapped in a hull
  return kept;
}

// How bright each vertex of a mesh is in the light of a lamp at the eye.
function lit(mesh, eye) {
  const normal = Array.from(mesh.x, () => [0, 0, 0]);
  const point = (n) => [mesh.x[n], mesh.y[n], mesh.z[n]];
  for (let t = 0; t < mesh.i.length; t++) {
    const [a, b, c] = [mesh.i[t], mesh.j[t], mesh.k[t]], across = cross(minus(point(b), point(a)), minus(point(c), point(a)));
    for (const n of [a, b, c]) { normal[n][0] += across.x; normal[n][1] += across.y; normal[n][2] += across.z; }
  }
  return normal.map(([x, y, z], n) => {
    const toward = minus(eye, point(n)), apart = Math.hypot(toward.x, toward.y, toward.z) || 1, size = Math.hypot(x, y, z) || 1;
    const facing = Math.abs(toward.x * x + toward.y * y + toward.z * z) / (apart * size);
    return (0.15 + 0.85 * facing) / (1 + (apart / LAMP_MM) ** 2);
  });
}

const toScene = (plot, point) => inScene(plot._fullLayout.scene, point);
const indices = (plot, is) => plot.data.flatMap((trace, k) => (is(trace) ? [k] : []));
const add = (point, along, much, beside = [0, 0, 0], more = 0) => point.map((value, k) => value + much * along[k] + more * beside[k]);
const minus = (a, b) => ({x: a[0] - b[0], y: a[1] - b[1], z: a[2] - b[2]});
