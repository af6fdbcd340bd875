// Draws every figure of the page once it is there. The data stand in <script type="application/json"> beside each figure.
(function () {
  "use strict";
  var PAPER_WIDTH = 1030; // style.css scales it to the sheet
  var NARROW = window.matchMedia("(max-width: 760px)").matches; // there a finger scrolls, and does not zoom
  var places = Array.from(document.querySelectorAll("figure .plot"));
  places.forEach(function (place) {
    var figure = JSON.parse(document.getElementById(place.id + "-data").textContent);
    if (NARROW) figure.layout.dragmode = false;
    Plotly.newPlot(place, figure.data, figure.layout, {
      responsive: true,
      displaylogo: false,
      modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
      toImageButtonOptions: { filename: place.id, format: "svg" },
    });
  });
  function width(value) {
    places.forEach(function (place) {
      Plotly.relayout(place, { width: value, autosize: value === null });
    });
  }
  window.addEventListener("beforeprint", function () { width(PAPER_WIDTH); });
  window.addEventListener("afterprint", function () { width(null); });
  document.documentElement.setAttribute("data-drawn", "yes");
})();
