// Draws the recordings of a report with BokehJS, so that they can be zoomed; without it the page keeps its SVG.
(() => {
  "use strict";
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const touch = window.matchMedia("(pointer: coarse)");
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const decoded = (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer));
  };
  const axes = ["x-axis", "y-axis", "z-axis"];

  // Closed outlines of the runs of finite values, as the glyph Patches takes them.
  const outlines = (time, low, high) => {
    const xs = [], ys = [];
    for (let first = 0; first < time.length; first++) {
      if (Number.isNaN(low[first])) continue;
      let end = first;
      while (end < time.length && !Number.isNaN(low[end])) end++;
      xs.push([...time.slice(first, end), ...time.slice(first, end).reverse()]);
      ys.push([...high.slice(first, end), ...low.slice(first, end).reverse()]);
      first = end;
    }
    return {xs, ys};
  };

  // The y axis shows all that the time axis shows.
  const fit = (plot, trace, start, end) => {
    let least = Infinity, most = -Infinity;
    trace.low.forEach((low, column) => {
      const high = trace.high[column];
      for (let row = 0; row < trace.time.length; row++) {
        if (trace.time[row] < start || trace.time[row] > end) continue;
        if (low[row] < least) least = low[row];
        if (high[row] > most) most = high[row];
      }
    });
    if (least > most) return;
    const margin = 0.06 * (most - least) || 0.05 * Math.abs(most) || 1;
    plot.y_range.setv({start: least - margin, end: most + margin});
  };

  const paint = (plot) => {
    const text = colour("ink"), line = colour("line");
    for (const axis of [...plot.xaxes, ...plot.yaxes])
      axis.setv({axis_label_text_color: text, major_label_text_color: text, axis_line_color: line,
        major_tick_line_color: line, minor_tick_line_color: null});
    for (const grid of [...plot.xgrids, ...plot.ygrids]) grid.setv({grid_line_color: line});
    for (const curve of plot.curves) curve.glyph.setv({line_color: colour(curve.tone), fill_color: colour(curve.tone)});
    for (const [box, kind] of plot.boxes) box.setv({fill_color: colour(kind), line_color: colour(kind)});
  };

  const drawn = (trace, recording, shared) => {
    const {Plotting, ColumnDataSource, Range1d, BoxAnnotation} = Bokeh;
    for (const name of ["low", "high"]) trace[name] = trace[name].map(decoded);
    trace.time = decoded(trace.time);
    const figure = Plotting.figure({height: 170, sizing_mode: "stretch_width", x_range: shared,
      y_range: new Range1d({start: 0, end: 1}), tools: "xpan,xbox_zoom,xwheel_zoom,reset",
      active_drag: touch.matches ? null : "xbox_zoom", toolbar_location: "right", min_border_right: 8});
    figure.toolbar.logo = null;
    figure.setv({background_fill_alpha: 0, border_fill_alpha: 0, outline_line_color: null});
    const boxes = trace.spans.map(([kind, left, right]) => {
      const box = new BoxAnnotation({left, right, fill_alpha: 0.3, line_alpha: 0.9, level: "underlay"});
      figure.add_layout(box);
      return [box, kind];
    });
    const curves = trace.low.map((low, column) => {
      const source = new ColumnDataSource({data: outlines(trace.time, low, trace.high[column])});
      const {glyph} = figure.patches({field: "xs"}, {field: "ys"}, {source, fill_alpha: 0.35, line_width: 1});
      return {glyph, tone: axes[column % 3]};
    });
    const [xaxes, yaxes] = [figure.xaxes ?? [figure.xaxis].flat(), figure.yaxes ?? [figure.yaxis].flat()];
    for (const axis of [...xaxes, ...yaxes]) axis.setv({axis_label_text_font_style: "normal"});
    xaxes[0].axis_label = `time (${recording.time_unit})`;
    yaxes[0].axis_label = trace.unit;
    yaxes[0].formatter.setv({power_limit_high: 8});  // 101325 Pa, not 1.01325e+5
    const grids = figure.center.filter((item) => "grid_line_color" in item);
    const plot = {figure, y_range: figure.y_range, xaxes, yaxes, xgrids: grids, ygrids: [], curves, boxes};
    fit(plot, trace, recording.start, recording.end);
    paint(plot);
    return plot;
  };

  for (const holder of document.querySelectorAll(".recording")) {
    const recording = JSON.parse(holder.querySelector("script").textContent);
    const shared = new Bokeh.Range1d({start: recording.start, end: recording.end});
    const plots = recording.traces.map((trace) => drawn(trace, recording, shared));
    const places = [...holder.querySelectorAll(".zoom")];
    const page = new Bokeh.Document();
    for (const {figure} of plots) page.add_root(figure);
    holder.classList.add("live");
    Bokeh.embed.add_document_standalone(page, document.body, places);
    const follow = () => plots.forEach((plot, row) => fit(plot, recording.traces[row], shared.start, shared.end));
    shared.properties.start.change.connect(follow);
    shared.properties.end.change.connect(follow);
    dark.addEventListener("change", () => plots.forEach(paint));
  }
})();
