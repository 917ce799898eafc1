"use strict";
// Draws each plot when it comes near the window, keeps the time axes of all together, follows light and dark,
// and lets the keyboard move a plot that has the focus: arrows pan, + and - zoom, 0 shows everything.
(() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const plots = [...document.querySelectorAll(".plot")];
  const drawn = new Set();
  let range = null; // of all time axes; null shows everything
  let following = false;

  const specOf = (plot) => JSON.parse(document.getElementById(`${plot.id}-spec`).textContent);

  function colours(layout, isDark) {
    const grid = isDark ? "#3a3a3a" : "#dcdcdc";
    const changes = { "font.color": isDark ? "#e8e8e8" : "#1b1b1b", "hoverlabel.bgcolor": isDark ? "#222" : "#fff" };
    for (const name of Object.keys(layout).filter((key) => /^[xy]axis\d*$/.test(key))) {
      changes[`${name}.gridcolor`] = changes[`${name}.zerolinecolor`] = changes[`${name}.linecolor`] = grid;
    }
    for (const axis of layout.scene ? ["xaxis", "yaxis", "zaxis"] : []) {
      changes[`scene.${axis}.gridcolor`] = changes[`scene.${axis}.zerolinecolor`] = grid;
    }
    return changes;
  }

  function assign(layout, changes) {
    for (const [path, value] of Object.entries(changes)) {
      const keys = path.split(".");
      const last = keys.pop();
      keys.reduce((at, key) => (at[key] ??= {}), layout)[last] = value;
    }
    return layout;
  }

  function draw(plot) {
    if (drawn.has(plot)) return;
    drawn.add(plot);
    const spec = specOf(plot);
    const layout = {
      margin: { l: 70, r: 16, t: 40, b: 56 },
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: 12 },
      legend: { orientation: "h", x: 0, y: 1, xanchor: "left", yanchor: "bottom" },
      hovermode: spec.timed ? "x" : "closest",
      dragmode: spec.timed ? "zoom" : "pan",
      ...spec.layout,
    };
    assign(layout, colours(layout, dark.matches));
    if (spec.timed && range) layout.xaxis.range = [...range];
    plot.dataset.timed = spec.timed;
    window.Plotly.newPlot(plot, spec.data, layout, {
      responsive: true,
      displaylogo: false,
      scrollZoom: !spec.timed,
      modeBarButtonsToRemove: ["select2d", "lasso2d"],
    });
    plot.dataset.drawn = "yes";
    if (spec.timed) plot.on("plotly_relayout", (change) => follow(plot, change));
  }

  function follow(source, change) {
    if (following) return;
    if (change["xaxis.autorange"]) range = null;
    else if ("xaxis.range[0]" in change) range = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    else if (change["xaxis.range"]) range = [...change["xaxis.range"]];
    else return;
    following = true;
    const others = [...drawn].filter((plot) => plot !== source && plot.dataset.timed === "true");
    const update = range ? { "xaxis.range": [...range] } : { "xaxis.autorange": true };
    Promise.all(others.map((plot) => window.Plotly.relayout(plot, update))).finally(() => (following = false));
  }

  const moves = {
    ArrowLeft: { x: -0.1 }, ArrowRight: { x: 0.1 }, ArrowUp: { y: 0.1 }, ArrowDown: { y: -0.1 },
    "+": { zoom: 0.8 }, "=": { zoom: 0.8 }, "-": { zoom: 1.25 },
  };

  function press(event) {
    const plot = event.currentTarget;
    if (event.target !== plot || event.ctrlKey || event.altKey || event.metaKey) return;
    const isMap = plot.dataset.timed === "false";
    const axes = isMap ? ["xaxis", "yaxis"] : ["xaxis"];
    if (!plot._fullLayout?.[axes[0]]) return; // a scene in three dimensions is turned with the pointer
    let update = {};
    if (event.key === "0") {
      for (const axis of axes) update[`${axis}.autorange`] = true;
    } else {
      const move = moves[event.key];
      if (!move || ("y" in move && !isMap)) return;
      for (const axis of axes) {
        const [low, high] = plot._fullLayout[axis].range;
        const shift = (move[axis[0]] ?? 0) * (high - low);
        const half = (move.zoom ?? 1) * (high - low) / 2;
        update[`${axis}.range`] = [(low + high) / 2 + shift - half, (low + high) / 2 + shift + half];
      }
    }
    event.preventDefault();
    window.Plotly.relayout(plot, update);
  }

  function recolour(isDark) {
    for (const plot of drawn) window.Plotly.relayout(plot, colours(plot.layout, isDark));
  }

  const near = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target)),
    { rootMargin: "400px" },
  );
  for (const plot of plots) {
    near.observe(plot);
    plot.addEventListener("keydown", press);
  }
  dark.addEventListener("change", () => recolour(dark.matches));
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((one) => (one.open = true));
    plots.forEach(draw);
    for (const plot of drawn) {
      const width = plot.closest(".beside") ? 335 : 680;
      window.Plotly.relayout(plot, { ...colours(plot.layout, false), width, autosize: false });
    }
  });
  window.addEventListener("afterprint", () => {
    for (const plot of drawn) {
      window.Plotly.relayout(plot, { ...colours(plot.layout, dark.matches), width: null, autosize: true });
    }
  });
})();
