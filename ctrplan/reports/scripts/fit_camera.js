// Moves the camera of a plotly scene as near as everything that layout.meta.view names is still seen, whatever the shape
// of the window. Plotly looks with 45 degrees from the top of a scene to its bottom; boxes have their middle at 0.
"use strict";

const HALF_VIEW = Math.tan(Math.PI / 8);
const LABELS = 48, RIM = 26;  // pixels around what is seen: labels of axes need more

// `home`: from where the scene is first seen; else from where it is looked at now.
function fitCamera(plot, home) {
  const {scene} = plot._fullLayout, view = (plot.layout.meta || {}).view;
  if (!home || !view) return moveTo(plot, fitted(plot, scene.camera.eye, scene.camera.up));
  const toward = vector(view.toward), along = vector(view.along);
  if (view.axes) return moveTo(plot, fitted(plot, toward, {x: 0, y: 0, z: 1}));
  const upright = along.z < -0.3 ? times(along, -1) : along;  // the head stays above
  const ways = [fitted(plot, toward, cross(toward, along)), fitted(plot, toward, upright)];
  return moveTo(plot, ways[0].away < 0.95 * ways[1].away ? ways[0] : ways[1]);
}

// The nearest camera that looks from a direction and sees all points, with them in the middle.
function fitted(plot, from, above) {
  const {scene, _size: size} = plot._fullLayout, view = (plot.layout.meta || {}).view, rim = view && !view.axes ? RIM : LABELS;
  const width = size.w * (scene.domain.x[1] - scene.domain.x[0]), height = size.h * (scene.domain.y[1] - scene.domain.y[0]);
  const across = HALF_VIEW * filled(width, rim) * width / height, along = HALF_VIEW * filled(height, rim);
  const toward = unit(from), right = unit(cross(above, toward)), up = cross(toward, right);
  const points = view && !view.axes ? view.points.map((point) => inScene(scene, point)) : corners(scene.aspectratio);
  let away = 0, center = {x: 0, y: 0, z: 0};
  for (let round = 0; round < 6; round++) {  // what is near looks larger: the middle of the picture is not that of the points
    const seen = points.map((point) => minus3(point, center));
    away = Math.max(...seen.map((p) => dot(p, toward) + Math.max(Math.abs(dot(p, right)) / across, Math.abs(dot(p, up)) / along)));
    const middle = (axis) => {
      const shares = seen.map((p) => dot(p, axis) / (away - dot(p, toward)));
      return away * (Math.min(...shares) + Math.max(...shares)) / 2;
    };
    const [aside, higher] = view && !view.axes ? [middle(right), middle(up)] : [0, 0];
    center = plus3(center, plus3(times(right, aside), times(up, higher)));
  }
  return {away, center, eye: plus3(center, times(toward, away)), up};
}

const moveTo = (plot, {eye, center, up}) => Plotly.relayout(plot, {"scene.camera": {eye, center, up}});

function keepFitted(plot) {
  let waiting;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(() => fitCamera(plot), 200); });
  return fitCamera(plot, true);
}

function corners(box) {
  const signs = [-0.5, 0.5];
  return signs.flatMap((i) => signs.flatMap((j) => signs.map((k) => ({x: i * box.x, y: j * box.y, z: k * box.z}))));
}

// A point in mm in the coordinates of plotly's cameras.
function inScene({aspectratio, ...scene}, point) {
  return Object.fromEntries(["x", "y", "z"].map((axis, k) => {
    const [low, high] = scene[`${axis}axis`].range;
    return [axis, (point[k] - (low + high) / 2) * aspectratio[axis] / (high - low)];
  }));
}

const filled = (pixels, rim) => Math.max(0.5, 1 - 2 * rim / pixels);
const vector = ([x, y, z]) => ({x, y, z});
const times = (a, much) => ({x: much * a.x, y: much * a.y, z: much * a.z});
const plus3 = (a, b) => ({x: a.x + b.x, y: a.y + b.y, z: a.z + b.z});
const minus3 = (a, b) => ({x: a.x - b.x, y: a.y - b.y, z: a.z - b.z});
const dot = (a, b) => a.x * b.x + a.y * b.y + a.z * b.z;
const cross = (a, b) => ({x: a.y * b.z - a.z * b.y, y: a.z * b.x - a.x * b.z, z: a.x * b.y - a.y * b.x});
const unit = (a) => { const length = Math.sqrt(dot(a, a)); return {x: a.x / length, y: a.y / length, z: a.z / length}; };
