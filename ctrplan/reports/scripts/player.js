// Plays the motion in a loop: the robot, the figures beside it, and the time on the curves that are on the screen.
"use strict";

const AT_THE_GOAL_MS = 1200;

function addPlayer(plot, motion) {
  const play = document.getElementById("play"), slider = document.getElementById("time");
  const still = {mode: "immediate", frame: {duration: 0, redraw: true}, transition: {duration: 0}};
  let timer = null;

  function show(k) {
    slider.value = k;
    Plotly.animate(plot, [motion.frames[k]], still);
    document.getElementById("now").textContent = `${motion.time_s[k].toFixed(1)} s`;
    for (const [name, values] of Object.entries(motion.figures)) document.getElementById(name).textContent = values[k];
    plot.dispatchEvent(new Event("moved"));
    for (const name of motion.curves) markTime(document.getElementById(name), motion.cursor, motion.time_s[k]);
  }

  function step() {
    const last = motion.frames.length - 1, k = Number(slider.value), next = k === last ? 0 : k + 1;
    show(next);
    timer = setTimeout(step, next === last ? AT_THE_GOAL_MS : motion.step_ms);
  }

  function toggle() {
    if (timer) { clearTimeout(timer); timer = null; } else step();
    play.textContent = timer ? "❚❚ Pause" : "▶ Play";
  }

  play.addEventListener("click", toggle);
  slider.addEventListener("input", () => { if (timer) toggle(); show(Number(slider.value)); });
}

function markTime(curves, cursor, time) {
  if (!curves || !curves._fullLayout) return;
  const {top, bottom} = curves.getBoundingClientRect();
  if (bottom < 0 || top > innerHeight) return;
  Plotly.relayout(curves, {[`shapes[${cursor}].x0`]: time, [`shapes[${cursor}].x1`]: time});
}
