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
  if (place.clientWidth < NARROW) fitPhone(figure.layout, place);
  return Plotly.newPlot(place, {...figure, config});
}

// Smaller letters and margins: headings of curves are as long as a phone is wide. Two panels side by side become two rows.
function fitPhone(layout, place) {
  layout.font = {...layout.font, size: 10.5};
  if (layout.margin && layout.margin.l) layout.margin = {...layout.margin, l: 46, r: 12};
  const {xaxis, yaxis, xaxis2, yaxis2} = layout;
  const beside = xaxis2 && yaxis2 && xaxis2.domain && xaxis2.domain[0] > xaxis.domain[1] && yaxis2.domain[1] === yaxis.domain[1];
  if (!beside || layout.xaxis3) return;
  layout.height = 1.8 * (layout.height || 340);
  place.style.height = `${layout.height}px`;
  Object.assign(xaxis, {domain: [0, 1]}); Object.assign(xaxis2, {domain: [0, 1]});
  Object.assign(yaxis, {domain: [0.58, 1]}); Object.assign(yaxis2, {domain: [0, 0.42], showticklabels: true});
  if (!(yaxis2.title || {}).text) yaxis2.title = yaxis.title;
}
