"use strict";
// Draws the plots of the page and moves the time cursor that the plots of one run share.
(() => {
  const touch = matchMedia("(pointer: coarse)").matches;
  const groups = {};
  const moving = {};
  const chooser = document.querySelector("select.colouring");
  // Without its bar of tools: dragging zooms, a double click goes back.
  const config = { responsive: true, displayModeBar: false };

  // Pages that follow the reader's colours have plots without a ground of their own.
  const dark =
    document.documentElement.classList.contains("auto") &&
    matchMedia("(prefers-color-scheme: dark)").matches;

  function darken(layout) {
    const style = layout.template.layout;
    style.paper_bgcolor = style.plot_bgcolor = "rgba(0,0,0,0)";
    style.font.color = "#e4e9ee";
    for (const axis of [style.xaxis, style.yaxis]) axis.gridcolor = "#323b45";
  }

  async function draw(holder) {
    if (holder.dataset.drawn) return;
    holder.dataset.drawn = "yes";
    const { data, layout } = JSON.parse(holder.nextElementSibling.textContent);
    if (dark) darken(layout);
    if (touch) layout.dragmode = false; // a finger scrolls the page
    await Plotly.newPlot(holder, data, layout, config);
    const meta = layout.meta || {};
    if (!meta.group) return;
    (groups[meta.group] ||= []).push(holder);
    holder.on("plotly_hover", (event) => point(meta, event));
    holder.on("plotly_legendclick", (event) => toggle(meta.group, event));
  }

  function point(meta, event) {
    const at = event.points[0];
    const time = meta.cursor === "track" ? at.customdata : event.xvals ? event.xvals[0] : at.x;
    if (!Number.isFinite(time)) return;
    if (!(meta.group in moving)) requestAnimationFrame(() => move(meta.group));
    moving[meta.group] = time;
  }

  function move(group) {
    const time = moving[group];
    delete moving[group];
    for (const holder of groups[group]) {
      const meta = holder.layout.meta;
      const change = meta.cursor === "track" ? markers(holder, meta, time) : line(time);
      Plotly.relayout(holder, change);
    }
  }

  function line(time) {
    return { "shapes[0].x0": time, "shapes[0].x1": time, "shapes[0].visible": true };
  }

  function markers(holder, meta, time) {
    const change = {};
    meta.curves.forEach((curve, k) => {
      const trace = holder.data[curve];
      const row = nearest(trace.customdata, time);
      const there = trace.x[row] != null && trace.visible !== "legendonly";
      change[`shapes[${k}].visible`] = there;
      if (there) {
        change[`shapes[${k}].xanchor`] = trace.x[row];
        change[`shapes[${k}].yanchor`] = trace.y[row];
      }
    });
    return change;
  }

  function nearest(times, time) {
    let low = 0;
    let high = times.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] > time) high = middle;
      else low = middle;
    }
    return time - times[low] < times[high] - time ? low : high;
  }

  // One legend entry shows or hides its curves in all plots of the run.
  function toggle(group, event) {
    const clicked = event.data[event.curveNumber];
    const visible = clicked.visible === "legendonly" ? true : "legendonly";
    for (const holder of groups[group]) {
      const same = holder.data.flatMap((trace, k) => (trace.name === clicked.name ? [k] : []));
      if (same.length) Plotly.restyle(holder, { visible }, same);
    }
    return false;
  }

  // The chooser says by which force the tracks are coloured.
  function colour() {
    for (const holder of document.querySelectorAll(".coloured .plot[data-drawn]")) {
      holder.data.forEach((trace, k) => {
        const own = (trace.meta || {}).colouring;
        if (own) Plotly.restyle(holder, { visible: own === chooser.value }, [k]);
      });
    }
  }

  async function all(within) {
    for (const holder of within.querySelectorAll(".plot")) {
      const fold = holder.closest("details");
      if (!fold || fold.open) await draw(holder);
    }
    if (chooser) colour();
  }

  for (const fold of document.querySelectorAll("details")) {
    fold.addEventListener("toggle", () => all(fold));
  }
  if (chooser) chooser.addEventListener("change", colour);
  all(document).then(() => {
    document.documentElement.dataset.plots = "drawn";
  });
})();
