"use strict";
// Draws the plots of the page and moves the time cursor that the plots of one run share.
(() => {
  const touch = matchMedia("(pointer: coarse)").matches;
  const groups = {};
  const moving = {};
  const sliders = {};
  const chooser = document.querySelector("select.colouring");
  // Without its bar of tools: dragging zooms, a double click goes back.
  const config = { responsive: true, displayModeBar: false };

  // Plots follow the reader's colours without a ground of their own; paper is always light.
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  const templates = new Map(); // of each plot, as it came

  function darkened(template) {
    const dark = structuredClone(template);
    const style = dark.layout;
    style.paper_bgcolor = style.plot_bgcolor = "rgba(0,0,0,0)";
    style.font.color = "#e4e9ee";
    for (const axis of [style.xaxis, style.yaxis]) axis.gridcolor = "#323b45";
    return dark;
  }

  // Lines that are too dark on a dark ground.
  const lighter = { "#0072b2": "#56a8e6", "#d55e00": "#f0833a" };
  const lines = new Map(); // colours of each plot's lines, as they came

  function tones(holder, dark) {
    return lines.get(holder).map((colour) => (dark && lighter[colour]) || colour);
  }

  function recolour(dark) {
    for (const [holder, template] of templates) {
      Plotly.relayout(holder, { template: dark ? darkened(template) : template });
      tones(holder, dark).forEach((colour, k) => {
        if (lighter[lines.get(holder)[k]]) Plotly.restyle(holder, { "line.color": colour }, [k]);
      });
    }
  }

  scheme.addEventListener("change", () => recolour(scheme.matches));
  addEventListener("beforeprint", () => scheme.matches && recolour(false));
  addEventListener("afterprint", () => scheme.matches && recolour(true));

  async function draw(holder) {
    if (holder.dataset.drawn) return;
    holder.dataset.drawn = "yes";
    const { data, layout } = JSON.parse(holder.nextElementSibling.textContent);
    const template = layout.template;
    if (scheme.matches) layout.template = darkened(template);
    if (touch) layout.dragmode = false; // a finger scrolls the page
    lines.set(holder, data.map((trace) => (trace.type || "scatter") === "scatter" && trace.line?.color));
    tones(holder, scheme.matches).forEach((colour, k) => {
      if (colour) data[k].line.color = colour;
    });
    await Plotly.newPlot(holder, data, layout, config);
    templates.set(holder, template);
    holder.on("plotly_afterplot", () => reachable(holder));
    reachable(holder);
    holder.tabIndex = 0;
    holder.addEventListener("keydown", (event) => zoom(holder, event));
    const meta = layout.meta || {};
    if (!meta.group) return;
    (groups[meta.group] ||= []).push(holder);
    if (meta.cursor === "track" && !sliders[meta.group]) slide(holder, meta);
    holder.on("plotly_hover", (event) => point(meta, event));
    holder.on("plotly_legendclick", (event) => {
      const curve = event.data[event.curveNumber];
      if (curve) toggle(groups[meta.group], curve);
      return false;
    });
  }

  // Every entry of a legend can be reached and pressed by keys; Plotly draws them anew at will.
  function reachable(holder) {
    for (const entry of holder.querySelectorAll(".legendtoggle")) {
      const { trace } = entry.__data__[0];
      entry.setAttribute("tabindex", "0");
      entry.setAttribute("role", "switch");
      entry.setAttribute("aria-label", trace.name);
      entry.setAttribute("aria-checked", String(trace.visible !== "legendonly"));
      const press = async () => {
        const { group } = holder.layout.meta || {};
        await toggle(group ? groups[group] : [holder], trace);
        const again = [...holder.querySelectorAll(".legendtoggle")];
        again.find((one) => one.getAttribute("aria-label") === trace.name)?.focus();
      };
      entry.onkeydown = (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        press();
      };
      // Plotly tells of clicks on curves alone.
      if (!holder.data.some((curve) => curve.name === trace.name)) entry.onclick = press;
    }
  }

  // Keys of a plot: + and - zoom, arrows move by a tenth, 0 shows all.
  const zooms = { "+": 0.7, "=": 0.7, "-": 1 / 0.7 };
  const moves = { ArrowLeft: ["x", -1], ArrowRight: ["x", 1], ArrowDown: ["y", -1], ArrowUp: ["y", 1] };

  function zoom(holder, event) {
    if (event.target !== holder || event.ctrlKey || event.metaKey || event.altKey) return;
    const axes = Object.keys(holder._fullLayout).filter((key) => /^[xy]axis\d*$/.test(key));
    const change = {};
    for (const axis of axes) {
      const [low, high] = holder._fullLayout[axis].range.map(Number);
      if (event.key === "0") {
        change[`${axis}.autorange`] = true;
      } else if (event.key in zooms && Number.isFinite(low + high)) {
        const half = (zooms[event.key] * (high - low)) / 2;
        change[`${axis}.range`] = [(low + high) / 2 - half, (low + high) / 2 + half];
      } else if (event.key in moves && moves[event.key][0] === axis[0] && Number.isFinite(low + high)) {
        const step = (moves[event.key][1] * (high - low)) / 10;
        change[`${axis}.range`] = [low + step, high + step];
      }
    }
    if (!Object.keys(change).length) return;
    event.preventDefault();
    Plotly.relayout(holder, change);
  }

  function point(meta, event) {
    const at = event.points[0];
    const time = meta.cursor === "track" ? at.customdata : event.xvals ? event.xvals[0] : at.x;
    if (!Number.isFinite(time)) return;
    follow(meta.group, time);
  }

  function follow(group, time) {
    if (!(group in moving)) requestAnimationFrame(() => move(group));
    moving[group] = time;
  }

  // A slider below the track says the time, for fingers and keys as well as for a mouse.
  function slide(holder, meta) {
    const times = meta.curves.flatMap((curve) => [
      holder.data[curve].customdata[0],
      holder.data[curve].customdata.at(-1),
    ]);
    const input = Object.assign(document.createElement("input"), { type: "range" });
    input.min = Math.min(...times);
    input.max = Math.max(...times);
    input.step = (input.max - input.min) / 500 || "any";
    input.value = input.min;
    input.setAttribute("aria-label", "time along the run, s");
    const label = document.createElement("label");
    label.className = "time";
    const output = document.createElement("output");
    output.textContent = "time";
    label.append(input, output);
    holder.after(label);
    sliders[meta.group] = label;
    input.addEventListener("input", () => follow(meta.group, Number(input.value)));
  }

  function move(group) {
    const time = moving[group];
    delete moving[group];
    if (sliders[group]) {
      const [input, output] = sliders[group].children;
      input.value = time;
      output.textContent = `${time.toFixed(1)} s`;
    }
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

  // One legend entry shows or hides its curves, or what is shaded, in all plots of the run.
  function toggle(holders, clicked) {
    const visible = clicked.visible === "legendonly" ? true : "legendonly";
    const named = (one, k) => (one.name === clicked.name ? [k] : []);
    return Promise.all(
      holders.flatMap((holder) => {
        const curves = holder.data.flatMap(named);
        const shapes = (holder.layout.shapes || []).flatMap(named);
        const change = Object.fromEntries(shapes.map((k) => [`shapes[${k}].visible`, visible]));
        return [
          curves.length && Plotly.restyle(holder, { visible }, curves),
          shapes.length && Plotly.relayout(holder, change),
        ];
      }),
    );
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
