// Moves the camera of a plotly scene so far back that its whole box is seen, whatever the shape of the window.
// Plotly looks with 45 degrees from the top of a scene to its bottom; boxes have their middle at 0.
"use strict";

const HALF_VIEW = Math.tan(Math.PI / 8), LABELS = 48;  // pixels around the box that the labels of its axes need
const NARROW = 500;  // pixels in which a colour scale would cover the robot

// `from`: the eye's direction, in the place of the one that is looked from now.
function fitCamera(plot, from) {
  const {scene, _size: size} = plot._fullLayout, {eye, up} = from ? {eye: from, up: {x: 0, y: 0, z: 1}} : scene.camera;
  const width = size.w * (scene.domain.x[1] - scene.domain.x[0]), height = size.h * (scene.domain.y[1] - scene.domain.y[0]);
  const across = HALF_VIEW * filled(width) * width / height, along = HALF_VIEW * filled(height);
  const toward = unit(eye), right = unit(cross(up, toward)), above = cross(toward, right);
  let away = 0;
  for (const corner of corners(scene.aspectratio)) {
    const needed = Math.max(Math.abs(dot(corner, right)) / across, Math.abs(dot(corner, above)) / along);
    away = Math.max(away, dot(corner, toward) + needed);
  }
  const moved = {x: away * toward.x, y: away * toward.y, z: away * toward.z};
  return Plotly.relayout(plot, {"scene.camera.eye": moved, "scene.camera.center": {x: 0, y: 0, z: 0}, "scene.camera.up": up});
}

function keepFitted(plot) {
  if (plot.clientWidth < NARROW) Plotly.restyle(plot, {"line.showscale": false});
  let waiting;
  window.addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(() => fitCamera(plot), 200); });
  return fitCamera(plot);
}

function corners(box) {
  const signs = [-0.5, 0.5];
  return signs.flatMap((i) => signs.flatMap((j) => signs.map((k) => ({x: i * box.x, y: j * box.y, z: k * box.z}))));
}

const filled = (pixels) => Math.max(0.5, 1 - 2 * LABELS / pixels);
const dot = (a, b) => a.x * b.x + a.y * b.y + a.z * b.z;
const cross = (a, b) => ({x: a.y * b.z - a.z * b.y, y: a.z * b.x - a.x * b.z, z: a.x * b.y - a.y * b.x});
const unit = (a) => { const length = Math.sqrt(dot(a, a)); return {x: a.x / length, y: a.y / length, z: a.z / length}; };
