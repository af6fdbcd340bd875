// Draws every figure of the page once it is there. The data stand in <script type="application/json"> beside each figure.
(function () {
  "use strict";
  var options = { responsive: true, displaylogo: false, modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };
  document.querySelectorAll("figure > .plot").forEach(function (place) {
    var figure = JSON.parse(document.getElementById(place.id + "-data").textContent);
    options.toImageButtonOptions = { filename: place.id, format: "svg" };
    Plotly.newPlot(place, figure.data, figure.layout, Object.assign({}, options));
  });
  document.documentElement.setAttribute("data-drawn", "yes");
})();
