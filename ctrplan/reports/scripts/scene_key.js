// The key of a scene beside it, a button for each part: on the scene it would cover the robot in small windows.
"use strict";

function addKey(plot, place) {
  const shown = plot.data.filter((trace) => trace.showlegend !== false && trace.name);
  place.append(...shown.map((trace) => keyEntry(plot, trace)));
}

function keyEntry(plot, trace) {
  const entry = document.createElement("button"), swatch = document.createElement("i");
  const same = plot.data.flatMap((other, i) => other.name === trace.name ? [i] : []);
  entry.type = "button";
  entry.title = "a click shows or hides it";
  entry.classList.toggle("off", Boolean((trace.meta || {}).later));
  swatch.style.background = (trace.meta || {}).swatch || trace.color || (trace.line || {}).color || trace.marker.color;
  entry.append(swatch, plainText(trace.name));
  entry.addEventListener("click", () => Plotly.restyle(plot, {visible: !entry.classList.toggle("off")}, same));
  return entry;
}

// Names of traces are HTML that holds nothing but text.
function plainText(markup) {
  return new DOMParser().parseFromString(markup, "text/html").documentElement.textContent;
}
