"use strict";
// Draws the charts whose data stand in the page; all numbers were computed before.
(function () {
  const charts = JSON.parse(document.getElementById("charts").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const config = {
    responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"],
    // Without a pointer that hovers the buttons would lie over the chart all the time.
    displayModeBar: window.matchMedia("(hover: hover)").matches ? "hover" : false,
  };
  const PRINT_WIDTH = 660; // pixels between the margins of A4
  let printing = false;

  function colours(onPaper) {
    const style = getComputedStyle(document.documentElement);
    const named = (name) => style.getPropertyValue(name).trim();
    if (printing || onPaper) return { ink: "#000000", line: "#cccccc", paper: "#ffffff" };
    return { ink: named("--ink"), line: named("--line"), paper: named("--paper") };
  }

  // The layout of a view with the colours of the page on every axis.
  function dressed(layout, width, onPaper, height) {
    const c = colours(onPaper);
    const axis = { gridcolor: c.line, linecolor: c.line, zerolinecolor: c.line, automargin: true };
    const out = {
      margin: { l: 60, r: 15, t: 30, b: 50 }, hovermode: "closest",
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", traceorder: "normal" },
      ...layout, paper_bgcolor: c.paper, plot_bgcolor: c.paper,
      font: { color: c.ink, family: "system-ui, DejaVu Sans, sans-serif", size: 12 },
    };
    if (width) out.width = width;
    if (height) out.height = height;
    out.xaxis = out.xaxis || {};
    out.yaxis = out.yaxis || {};
    for (const key of Object.keys(out)) {
      if (/^[xy]axis\d*$/.test(key)) out[key] = { ...axis, ...out[key] };
    }
    if (out.polar) {
      out.polar = { ...out.polar, bgcolor: c.paper };
      for (const key of ["angularaxis", "radialaxis"]) {
        out.polar[key] = { gridcolor: c.line, linecolor: c.line, ...out.polar[key] };
      }
    }
    if (out.scene) {
      out.scene = { ...out.scene };
      for (const key of ["xaxis", "yaxis", "zaxis"]) {
        out.scene[key] = { gridcolor: c.line, zerolinecolor: c.line, ...out.scene[key] };
      }
    }
    return out;
  }

  // A copy for plotly, which writes into what it is given.
  const copy = (value) => JSON.parse(JSON.stringify(value));

  function chosen(chart) {
    const menu = document.getElementById(chart.id + "-menu");
    return chart.views[menu ? Number(menu.value) : 0];
  }

  // plotly draws WebGL where paper cannot follow: keep a picture of it for printing.
  function still(chart) {
    const image = document.getElementById(chart.id + "-still");
    if (!image) return Promise.resolve();
    const plot = document.getElementById(chart.id + "-plot");
    const layout = dressed(copy(chosen(chart).layout), PRINT_WIDTH, true, chart.print_height);
    const turned = plot.layout && plot.layout.scene && plot.layout.scene.camera;
    if (turned) layout.scene.camera = copy(turned);
    return Plotly.toImage({ data: copy(chosen(chart).data), layout }, { format: "png", width: PRINT_WIDTH, height: chart.print_height, scale: 3 })
      .then((url) => {
        image.src = url;
        image.closest("figure").classList.add("has-still");
      })
      .catch(() => {});
  }

  function draw(chart, width, height) {
    const plot = document.getElementById(chart.id + "-plot");
    const view = chosen(chart);
    return Plotly.react(plot, copy(view.data), dressed(copy(view.layout), width, false, height), config)
      .catch((error) => { plot.textContent = "This chart cannot be drawn here: " + error; });
  }

  const each = (work) => charts.reduce(
    (done, chart) => done.then(() => work(chart)), Promise.resolve());

  // The stills take longest: first everything that a reader sees.
  const all = () => each((chart) => draw(chart)).then(() => each(still));

  for (const chart of charts) {
    const menu = document.getElementById(chart.id + "-menu");
    if (menu) menu.addEventListener("change", () => draw(chart).then(() => still(chart)));
  }
  dark.addEventListener("change", () => all());
  window.addEventListener("beforeprint", () => {
    printing = true;
    for (const chart of charts) draw(chart, PRINT_WIDTH, chart.print_height);
  });
  window.addEventListener("afterprint", () => { printing = false; all(); });
  all().then(() => { document.documentElement.dataset.ready = "true"; });
})();
