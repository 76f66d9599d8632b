// Unpacks what a page carries compressed: the library first, then every figure. Nothing is loaded from anywhere.
"use strict";

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
  return Plotly.newPlot(place, {...JSON.parse(await unpacked(text)), config});
}
