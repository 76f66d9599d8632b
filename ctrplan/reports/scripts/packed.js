// Unpacks what a page carries compressed: the library first, then every figure. Nothing is loaded from anywhere.
"use strict";

const NARROW = 500;  // pixels

function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).text();
}

function library(text) {
  return unpacked(text).then((code) => {
    const element = document.createElement("script");
    element.textContent = code;
    document.head.append(element);
  });
}

async function drawn(name, text, config) {
  const place = document.getElementById(name);
  if (typeof DecompressionStream === "undefined") {
    place.textContent = "This figure needs a browser of 2023 or later.";
    return new Promise(() => {});
  }
  await plotly;
  const figure = JSON.parse(await unpacked(text));
  if (place.clientWidth < NARROW) fitPhone(figure.layout);
  return Plotly.newPlot(place, {...figure, config});
}

// Smaller letters and margins: headings of curves are as long as a phone is wide.
function fitPhone(layout) {
  layout.font = {...layout.font, size: 10.5};
  if (layout.margin && layout.margin.l) layout.margin = {...layout.margin, l: 46, r: 12};
}
