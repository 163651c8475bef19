// The charts of the report: everything is drawn as SVG from the numbers in the page, and coloured by its style sheet,
// so that theme and paper need no redrawing. Text only ever becomes text (textContent), never markup.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const DASHES = ["", "7 3", "2 3", "10 3 2 3", "14 4", "5 2 1 2"];
  const UNITS = { "km/h": 3.6, mph: 1 / 0.44704 };
  const MARGIN = { left: 50, right: 10, top: 22, bottom: 6 };
  const AXIS = 24; // px below the lowest panel
  const LINE = 15; // px of a title that takes another line
  const WIDEST = 2; // times the reach of its line that a band may widen a panel at each side, lest an outage flatten it
  const data = JSON.parse(document.getElementById("data").textContent);
  const place = (id) => document.getElementById(id);

  function floats(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new Float32Array(bytes.buffer);
  }
  function rows(name) {
    const all = floats(data.traces[name]);
    const n = grid.length;
    return data.laps.map((_, i) => all.subarray(i * n, (i + 1) * n));
  }
  const grid = floats(data.grid);
  const traces = Object.fromEntries(Object.keys(data.traces).map((name) => [name, rows(name)]));
  const state = { slots: new Map(), at: 0, range: [0, grid.length - 1], unit: "km/h", coloured: data.best };
  const cursors = []; // called with the index of the grid whenever the cursor moves

  // ---- small helpers ----
  function make(tag, attributes, parent) {
    const node = document.createElementNS(SVG, tag);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (parent) parent.appendChild(node);
    return node;
  }
  function html(tag, text, parent) {
    const node = document.createElement(tag);
    node.textContent = text;
    if (parent) parent.appendChild(node);
    return node;
  }
  function write(parent, x, y, text, kind, anchor) {
    make("text", { x, y, class: kind || "", "text-anchor": anchor || "start" }, parent).textContent = text;
  }
  const factor = () => UNITS[state.unit];
  function fixed(value, digits, signed) {
    if (!Number.isFinite(value)) return "–";
    const text = value.toFixed(digits), isNothing = Number(text) === 0;
    return (signed && (value >= 0 || isNothing) ? "+" : "") + (isNothing ? text.replace("-", "") : text);
  }
  const two = (n) => String(Math.floor(n)).padStart(2, "0");
  const clock = (s) => s < 3600 ? `${Math.floor(s / 60)}:${two(s % 60)}` : `${Math.floor(s / 3600)}:${two(s / 60 % 60)}:${two(s % 60)}`;
  const along = (x) => (data.axis === "time" ? clock(x) : `${x.toFixed(0)} m`);
  function niceStep(span, most) {
    const rough = span / most;
    const power = 10 ** Math.floor(Math.log10(rough));
    return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= rough);
  }
  function ticks(low, high, most) { // a single one shows no scale: then finer ones
    const step = niceStep(high - low || 1, most);
    const out = [];
    for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + step * 1e-6; v += step) out.push(v);
    if (out.length < 2 && most < 5) return ticks(low, high, most + 1);
    return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  }
  function clockTicks(low, high, most) {
    const step = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200].find((s) => (high - low) / s <= most) || 14400;
    const out = [];
    for (let v = Math.ceil(low / step) * step; v <= high; v += step) out.push(v);
    return out;
  }
  function extent(lists, first, last) {
    let low = Infinity, high = -Infinity;
    for (const list of lists) {
      const end = Math.min(last ?? list.length - 1, list.length - 1);
      for (let i = first ?? 0; i <= end; i++) {
        if (list[i] < low) low = list[i];
        if (list[i] > high) high = list[i];
      }
    }
    return low <= high ? [low, high] : [0, 1];
  }
  function trail(xs, ys, X, Y, first, last) {
    let d = "", pen = false;
    for (let i = first; i <= last; i++) {
      if (Number.isFinite(xs[i]) && Number.isFinite(ys[i])) {
        d += `${pen ? "L" : "M"}${X(xs[i]).toFixed(1)} ${Y(ys[i]).toFixed(1)}`;
        pen = true;
      } else pen = false;
    }
    return d;
  }
  function bandOf(xs, ys, sigma, X, Y, first, last) {
    let d = "", run = [];
    const close = () => {
      if (run.length > 1) {
        const up = run.map((i) => `${X(xs[i]).toFixed(1)} ${Y(ys[i] + 2 * sigma[i]).toFixed(1)}`);
        const down = run.map((i) => `${X(xs[i]).toFixed(1)} ${Y(ys[i] - 2 * sigma[i]).toFixed(1)}`).reverse();
        d += `M${up.concat(down).join("L")}Z`;
      }
      run = [];
    };
    for (let i = first; i <= last; i++) {
      if (Number.isFinite(ys[i]) && Number.isFinite(sigma[i])) run.push(i);
      else close();
    }
    close();
    return d;
  }
  function around(series, first, last, least) { // limits that hold lines and bands, and whether a band goes beyond
    const lines = extent(series.map((s) => s.y), first, last);
    const edges = series.filter((s) => s.sigma).flatMap((s) => [-2, 2].map((k) => s.y.map((y, i) => y + k * s.sigma[i])));
    const bands = extent([...series.map((s) => s.y), ...edges], first, last);
    const most = WIDEST * Math.max(lines[1] - lines[0], least);
    const limits = [Math.max(bands[0], lines[0] - most), Math.min(bands[1], lines[1] + most)];
    return [limits, limits[0] > bands[0] || limits[1] < bands[1]];
  }
  function sureOnly(values, sure, first, last) { // without what is not sure, unless nothing else is there
    const kept = sure ? values.map((v, i) => (sure[i] ? v : NaN)) : values;
    return kept.slice(first, last + 1).some(Number.isFinite) ? kept : values;
  }
  const spare = ([low, high]) => 0.06 * (high - low || 1); // above and below the limits of a panel
  const holds = (limits, [low, high]) => limits[0] - spare(limits) <= low && limits[1] + spare(limits) >= high;
  function nearest(list, value) {
    let low = 0, high = list.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (list[middle] < value) low = middle;
      else high = middle;
    }
    return value - list[low] < list[high] - value ? low : high;
  }
  function swatch(slot) {
    const svg = make("svg", { viewBox: "0 0 26 10", "aria-hidden": "true" });
    if (slot !== undefined) make("path", { d: "M1 5H25", class: `line s${slot % 6}`, "stroke-width": 3, "stroke-dasharray": DASHES[slot % 6] }, svg);
    return svg;
  }

  // ---- titles: as many lines as a narrow screen makes of them ----
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = `600 12px ${getComputedStyle(document.body).fontFamily}`; // as .chart text.title
  function wrapped(text, room) {
    const fits = (line) => pen.measureText(line).width <= room;
    const lines = [""];
    for (let word of text.split(" ")) {
      const last = lines.length - 1, longer = lines[last] ? `${lines[last]} ${word}` : word;
      if (fits(longer)) { lines[last] = longer; continue; }
      if (lines[last]) lines.push("");
      while (!fits(word) && word.length > 1) { // a name without a space may be wider than the screen
        let n = word.length - 1;
        while (n > 1 && !fits(word.slice(0, n))) n--;
        lines.splice(-1, 1, word.slice(0, n), "");
        word = word.slice(n);
      }
      lines[lines.length - 1] = word;
    }
    return lines;
  }
  const titleLines = (title, width) => wrapped(title, width - MARGIN.left - MARGIN.right);
  const grown = (height, title, width) => height + LINE * (titleLines(title, width).length - 1);

  function clipped(svg, x, y, width, height) { // what is drawn into it shows inside this box only
    const id = `clip-${++clipped.count}`;
    const shape = make("clipPath", { id }, make("defs", {}, svg));
    make("rect", { x, y, width: Math.max(0, width), height: Math.max(0, height) }, shape);
    return make("g", { "clip-path": `url(#${id})` }, svg);
  }
  clipped.count = 0;

  // ---- one panel: y over a shared x ----
  function panel(svg, box, spec) {
    const { x0, x1, width } = spec;
    const left = MARGIN.left, right = width - MARGIN.right;
    const lines = titleLines(spec.title, width);
    const top = box.top + MARGIN.top + LINE * (lines.length - 1), bottom = box.top + box.height - MARGIN.bottom;
    const X = (x) => left + ((x - x0) / (x1 - x0 || 1)) * (right - left);
    let [low, high] = spec.limits;
    const least = spec.least || 0;
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const space = spare([low, high]);
    [low, high] = [spec.floor ?? low - space, high + space];
    const Y = (y) => bottom - ((y - low) / (high - low)) * (bottom - top);
    for (const bend of spec.bends || []) {
      const [a, b] = [Math.max(bend[0], x0), Math.min(bend[1], x1)];
      if (b > a) make("rect", { x: X(a), y: top, width: X(b) - X(a), height: bottom - top, class: "bend" }, svg);
    }
    const [marks, digits] = ticks(low, high, Math.max(2, Math.floor((bottom - top) / 25)));
    for (const mark of marks) {
      const isZero = Math.abs(mark) < 1e-9;
      make("path", { d: `M${left} ${Y(mark).toFixed(1)}H${right}`, class: isZero && low < 0 ? "zero" : "grid" }, svg);
      write(svg, left - 6, Y(mark) + 4, (isZero ? 0 : mark).toFixed(digits), "", "end");
    }
    lines.forEach((line, i) => write(svg, left, box.top + 14 + LINE * i, line, "title"));
    const inside = clipped(svg, left, top - 2, right - left, bottom - top + 4);
    for (const s of spec.series) {
      const [first, last] = s.span || [0, s.x.length - 1];
      if (s.sigma) make("path", { d: bandOf(s.x, s.y, s.sigma, X, Y, first, last), class: `band f${s.slot % 6}` }, inside);
    }
    for (const s of spec.series) {
      const [first, last] = s.span || [0, s.x.length - 1];
      const look = { class: `${s.dots ? "points" : "line"} ${s.kind || "s" + (s.slot % 6)}`, "stroke-dasharray": s.dots ? "" : s.dash ?? DASHES[(s.slot || 0) % 6] };
      if (s.dots) {
        let d = "";
        for (let i = first; i <= last; i++) if (Number.isFinite(s.y[i])) d += `M${X(s.x[i]).toFixed(1)} ${Y(Math.min(s.y[i], high)).toFixed(1)}h0`;
        make("path", { d, ...look }, inside);
      } else if (s.sure) {
        const pick = (wanted) => s.y.map((y, i) => (s.sure[i] === wanted || s.sure[i + 1] === wanted || s.sure[i - 1] === wanted ? y : NaN));
        make("path", { d: trail(s.x, pick(0), X, Y, first, last), ...look, class: "line raw unsure" }, inside);
        make("path", { d: trail(s.x, pick(1), X, Y, first, last), ...look }, inside);
      } else make("path", { d: trail(s.x, s.y, X, Y, first, last), ...look }, inside);
    }
    return { X, Y, top, bottom, left, right };
  }
  function bottomAxis(svg, x0, x1, width, y, isTime) {
    const X = (x) => MARGIN.left + ((x - x0) / (x1 - x0 || 1)) * (width - MARGIN.left - MARGIN.right);
    const [marks, digits] = isTime ? [clockTicks(x0, x1, Math.min(9, width / 65)), 0] : ticks(x0, x1, Math.max(2, Math.floor(width / 90)));
    for (const mark of marks) {
      const text = isTime ? clock(mark) : mark.toFixed(digits);
      make("path", { d: `M${X(mark).toFixed(1)} ${y}v4`, class: "line faint" }, svg);
      write(svg, Math.min(X(mark), width - 4 * text.length), y + 17, text, "", "middle"); // the last one stays on the sheet
    }
  }
  const room = (id, wanted) => wanted || Math.max(280, Math.round(place(id).clientWidth));
  function sheet(id, height, wanted) {
    const figure = place(id);
    const old = figure.querySelector("svg");
    const width = room(id, wanted);
    const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, class: "chart", role: "img", "aria-label": figure.dataset.label || "" });
    if (old) old.replaceWith(svg);
    else figure.prepend(svg);
    return [svg, width];
  }

  // ---- traces ----
  const PANELS = [
    { name: "speed", title: () => `speed (${state.unit})`, height: 170, scale: factor, sureOnly: true, least: 5 },
    { name: "delta", title: () => `time lost to ${data.against_name} (s), band: two sigma`, height: 140, sigma: "delta_sigma", least: 0.1 },
    { name: "longitudinal", title: () => "accelerating + and braking − (g)", height: 120, scale: () => 1 / 9.80665, sureOnly: true, least: 0.5 },
    { name: "sideways", title: () => "sideways (g), left +", height: 120, scale: () => 1 / 9.80665, sureOnly: true, least: 0.5 },
    { name: "sideslip", title: () => "sideslip (deg), + heading right of the path, band: two sigma", height: 130, sigma: "sideslip_sigma", least: 10 },
    { name: "offset", title: () => "line: metres left of the mean line, band: two sigma, grey: within noise", height: 140, sigma: "offset_sigma", sure: "is_off", least: 1 },
  ];
  function drawTraces(wanted) {
    const wide = room("traces", wanted);
    const [first, last] = state.range, laps = [...state.slots.keys()];
    const logged = (data.channels || []).map((c) => ({ name: c.name, title: () => c.title, height: 110, least: 1e-6 }));
    const panels = [...PANELS, ...logged].filter((p) => traces[p.name]).map((p) => {
      const k = p.scale ? p.scale() : 1;
      const series = [...state.slots].map(([lap, slot]) => ({
        x: grid, y: traces[p.name][lap].map((v) => v * k), slot, span: [first, last],
        sigma: p.sigma && traces[p.sigma] ? traces[p.sigma][lap] : null,
        sure: p.sure && traces[p.sure] ? traces[p.sure][lap] : null,
      }));
      const scaled = series.map((s, i) => ({ ...s, y: sureOnly(s.y, p.sureOnly && traces.is_sure && traces.is_sure[laps[i]], first, last) }));
      const [limits, isCut] = around(scaled, first, last, p.least);
      const beyond = isCut ? "; the band goes on beyond the frame" : holds(limits, extent(series.map((s) => s.y), first, last)) ? "" : "; unsure parts go on beyond the frame";
      const title = p.title() + beyond;
      return { ...p, series, limits, title, height: grown(wanted ? 0.75 * p.height : p.height, title, wide) }; // map and traces fit one sheet of paper
    });
    const total = panels.reduce((sum, p) => sum + p.height, 0) + AXIS;
    const [svg, width] = sheet("traces", total, wanted);
    const [x0, x1] = [grid[first], grid[last]];
    const bends = data.corners.map((c) => [c.start, c.end]);
    let top = 0, frame, highest;
    const marks = [];
    for (const p of panels) {
      frame = panel(svg, { top, height: p.height }, { ...p, x0, x1, width, bends });
      highest ??= frame.top;
      for (const s of p.series) marks.push([make("circle", { r: 4, class: `dot f${s.slot % 6}` }, svg), s.y, frame.Y]);
      top += p.height;
    }
    const range = data.corners.filter((c) => c.apex > x0 && c.apex < x1);
    const free = [0, 0]; // two rows of numbers, else left out: the bands of their corners are there
    for (const c of range) {
      const x = frame.X(c.apex), half = 4 * String(c.number).length + 1;
      const level = free.findIndex((end) => x - half >= end);
      if (level < 0) continue;
      write(svg, x, highest + 8 + LINE * level, c.number, "corner", "middle");
      free[level] = x + half;
    }
    bottomAxis(svg, x0, x1, width, top, data.axis === "time");
    if (data.axis === "distance") write(svg, MARGIN.left - 12, top + 17, "m", "", "end");
    const cursor = make("path", { class: "cursor" }, svg);
    cursors.push((at) => {
      const x = frame.X(grid[at]);
      const shown = at >= first && at <= last;
      cursor.setAttribute("d", shown ? `M${x.toFixed(1)} ${highest}V${top}` : "");
      for (const [dot, y, Y] of marks) {
        const there = shown && Number.isFinite(y[at]);
        dot.setAttribute("visibility", there ? "visible" : "hidden");
        if (there) { dot.setAttribute("cx", x); dot.setAttribute("cy", Y(y[at])); }
      }
    });
    listenTraces(svg, frame, x0, x1, width, top);
  }
  function listenTraces(svg, frame, x0, x1, width, height) {
    const at = (event) => {
      const r = svg.getBoundingClientRect();
      const x = ((event.clientX - r.left) / r.width) * width;
      const share = Math.min(1, Math.max(0, (x - frame.left) / (frame.right - frame.left)));
      return nearest(grid, x0 + share * (x1 - x0));
    };
    let start = null, shade = null;
    svg.addEventListener("pointermove", (event) => {
      const here = at(event);
      moveTo(here);
      if (start === null) return;
      shade = shade || make("rect", { y: 0, height, class: "drag" }, svg);
      const [a, b] = [frame.X(grid[Math.min(start, here)]), frame.X(grid[Math.max(start, here)])];
      shade.setAttribute("x", a);
      shade.setAttribute("width", b - a);
    });
    svg.addEventListener("pointerdown", (event) => { if (event.pointerType === "mouse" && event.button === 0) start = at(event); moveTo(at(event)); });
    svg.addEventListener("pointerup", (event) => {
      const here = at(event);
      if (start !== null && Math.abs(here - start) > 4) show([Math.min(start, here), Math.max(start, here)]);
      else if (shade) shade.remove();
      start = null; shade = null;
    });
    svg.addEventListener("pointerleave", () => { if (shade) shade.remove(); start = null; shade = null; });
    svg.addEventListener("dblclick", () => show([0, grid.length - 1]));
  }

  // ---- map ----
  function fit(xs, ys, width, height, margin) {
    const [ax, bx] = extent(xs), [ay, by] = extent(ys);
    const scale = Math.min((width - 2 * margin) / Math.max(bx - ax, 5), (height - 2 * margin) / Math.max(by - ay, 5));
    const [cx, cy] = [(ax + bx) / 2, (ay + by) / 2];
    return { scale, X: (x) => width / 2 + (x - cx) * scale, Y: (y) => height / 2 - (y - cy) * scale };
  }
  function scaleBar(svg, scale, width, height) {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000].filter((m) => m * scale < width / 3).pop() || 1;
    make("path", { d: `M12 ${height - 12}h${metres * scale}m0 -4v8M12 ${height - 16}v8`, class: "line", stroke: "currentColor" }, svg);
    write(svg, 12, height - 20, `${metres} m, north up`);
  }
  function drawMap(wanted) {
    const lap = state.coloured, [first, last] = state.range;
    const box = place("map").clientWidth;
    const width0 = wanted || Math.max(280, box);
    const height = Math.round(Math.min(width0 * 0.95, wanted ? 230 : 520));
    const [svg, width] = sheet("map", height + 34, wanted);
    const laps = [...state.slots.keys()];
    const cut = (list) => list.subarray(first, last + 1);
    const { scale, X, Y } = fit([...laps, lap].map((i) => cut(traces.x[i])), [...laps, lap].map((i) => cut(traces.y[i])), width, height, 26);
    const inside = clipped(svg, 0, 0, width, height);
    if (data.mean_line) make("path", { d: trail(meanLine.x, meanLine.y, X, Y, 0, meanLine.x.length - 1), class: "line faint" }, inside);
    for (const i of laps.filter((i) => i !== lap)) {
      const slot = state.slots.get(i);
      make("path", { d: trail(traces.x[i], traces.y[i], X, Y, first, last), class: `line s${slot % 6}`, "stroke-dasharray": DASHES[slot % 6] }, inside);
    }
    make("path", { d: trail(traces.x[lap], traces.y[lap], X, Y, first, last), class: "casing" }, inside);
    const [slow, fast] = extent([sureOnly(traces.speed[lap], traces.is_sure && traces.is_sure[lap], first, last)], first, last);
    const shades = data.palette.map(() => "");
    const bin = (v) => Math.max(0, Math.min(shades.length - 1, Math.floor(((v - slow) / (fast - slow || 1)) * shades.length)));
    for (let i = first; i < last; i++) {
      const [a, b] = [traces.x[lap][i], traces.x[lap][i + 1]];
      if (!Number.isFinite(a + b) || !Number.isFinite(traces.speed[lap][i])) continue;
      shades[bin(traces.speed[lap][i])] += `M${X(a).toFixed(1)} ${Y(traces.y[lap][i]).toFixed(1)}L${X(b).toFixed(1)} ${Y(traces.y[lap][i + 1]).toFixed(1)}`;
    }
    shades.forEach((d, i) => d && make("path", { d, class: "speed", stroke: data.palette[i] }, inside));
    for (const g of data.gates) {
      const [a, b, c, d] = [X(g.x[0]), Y(g.y[0]), X(g.x[1]), Y(g.y[1])];
      const isShown = Math.abs(a + c - width) < width && Math.abs(b + d - height) < height; // its middle
      if (isShown) make("path", { d: `M${a} ${b}L${c} ${d}`, class: g.is_start ? "gate" : "split" }, inside);
    }
    const range = data.corners.filter((c) => c.apex >= grid[first] && c.apex <= grid[last]);
    for (const c of range) write(inside, X(c.x) + c.out_x * 17, Y(c.y) - c.out_y * 17 + 4, c.number, "corner", "middle");
    scaleBar(svg, scale, width, height);
    const isCut = !holds([slow, fast], extent([traces.speed[lap]], first, last));
    colourBar(svg, slow, fast, width, height, isCut ? "≥ " : "");
    const dots = laps.map((i) => [make("circle", { r: 6, class: `dot f${state.slots.get(i) % 6}` }, inside), i]);
    cursors.push((at) => {
      for (const [dot, i] of dots) {
        const there = Number.isFinite(traces.x[i][at]) && Number.isFinite(traces.y[i][at]);
        dot.setAttribute("visibility", there ? "visible" : "hidden");
        if (there) { dot.setAttribute("cx", X(traces.x[i][at])); dot.setAttribute("cy", Y(traces.y[i][at])); }
      }
    });
    const seek = (event) => {
      const r = svg.getBoundingClientRect();
      const [px, py] = [((event.clientX - r.left) / r.width) * width, ((event.clientY - r.top) / r.width) * width];
      let best = -1, least = 40 ** 2;
      for (let i = first; i <= last; i++) {
        const away = (X(traces.x[lap][i]) - px) ** 2 + (Y(traces.y[lap][i]) - py) ** 2;
        if (away < least) [best, least] = [i, away];
      }
      if (best >= 0) moveTo(best);
    };
    svg.addEventListener("pointermove", seek);
    svg.addEventListener("pointerdown", seek);
  }
  function colourBar(svg, slow, fast, width, height, from) {
    const n = data.palette.length, w = Math.min(220, width - 150) / n, left = (width - n * w) / 2;
    data.palette.forEach((c, i) => make("rect", { x: left + i * w, y: height + 8, width: w + 0.6, height: 10, fill: c }, svg));
    write(svg, left - 6, height + 17, (slow * factor()).toFixed(0), "", "end");
    write(svg, left + n * w + 6, height + 17, `${from}${(fast * factor()).toFixed(0)} ${state.unit}`);
  }

  // ---- g-g diagram ----
  function drawCircle(wanted) {
    if (!traces.longitudinal) return;
    const size0 = wanted ? Math.min(340, wanted) : Math.min(460, Math.max(280, place("circle").clientWidth));
    const [svg] = sheet("circle", size0, size0);
    const cloud = [floats(data.cloud.right), floats(data.cloud.forward)];
    const reach = Math.max(0.5, data.cloud.reach);
    const half = size0 / 2, scale = (half - 26) / reach;
    const X = (v) => half + v * scale, Y = (v) => half - v * scale;
    const rings = [];
    for (let r = 0.5; r <= reach * 1.05; r += 0.5) rings.push(r);
    for (const r of rings) make("circle", { cx: half, cy: half, r: r * scale, class: "grid" }, svg);
    make("path", { d: `M20 ${half}H${size0 - 20}M${half} 20V${size0 - 20}`, class: "grid" }, svg);
    const dots = (right, forward) => {
      let d = "";
      for (let i = 0; i < right.length; i++) if (Number.isFinite(right[i] + forward[i])) d += `M${X(right[i]).toFixed(1)} ${Y(forward[i]).toFixed(1)}h0`;
      return d;
    };
    const inside = clipped(svg, 0, 0, size0, size0);
    make("path", { d: dots(...cloud), class: "cloud" }, inside);
    const [first, last] = state.range;
    for (const [lap, slot] of state.slots) {
      const right = traces.sideways[lap].subarray(first, last + 1).map((v) => -v / 9.80665);
      const forward = traces.longitudinal[lap].subarray(first, last + 1).map((v) => v / 9.80665);
      make("path", { d: dots(right, forward), class: `points s${slot % 6}` }, inside);
    }
    for (const r of rings) write(svg, half + 0.7071 * r * scale + 3, half - 0.7071 * r * scale - 3, `${r} g`, "over");
    write(svg, half, 14, "accelerating", "over", "middle");
    write(svg, half, size0 - 6, "braking", "over", "middle");
    write(svg, 4, half - 6, "left", "over");
    write(svg, size0 - 4, half - 6, "right", "over", "end");
    const marks = [...state.slots].map(([lap, slot]) => [make("circle", { r: 6, class: `dot f${slot % 6}` }, inside), lap]);
    cursors.push((at) => {
      for (const [mark, lap] of marks) {
        const [r, f] = [-traces.sideways[lap][at] / 9.80665, traces.longitudinal[lap][at] / 9.80665];
        mark.setAttribute("visibility", Number.isFinite(r + f) ? "visible" : "hidden");
        if (Number.isFinite(r + f)) { mark.setAttribute("cx", X(r)); mark.setAttribute("cy", Y(f)); }
      }
    });
  }

  // ---- baseline against smoother; quality ----
  const unpack = (group) => (group ? Object.fromEntries(Object.entries(group).map(([k, v]) => [k, typeof v === "string" ? floats(v) : v])) : null);
  const meanLine = unpack(data.mean_line), compared = unpack(data.compared), quality = unpack(data.quality);
  function shownTimes() {
    if (!compared.grid_t) return [-Infinity, Infinity];
    return [compared.grid_t[state.range[0]], compared.grid_t[state.range[1]]];
  }
  function drawCompared(wanted) {
    if (!compared) return;
    const [from, to] = shownTimes();
    const part = (t) => [nearest(t, Math.max(from, t[0])), nearest(t, Math.min(to, t[t.length - 1]))];
    const [a, b] = part(compared.t);
    const width0 = wanted ? wanted / 2 - 10 : Math.max(280, place("compared-map").clientWidth);
    const height = Math.round(Math.min(width0 * 0.85, 440));
    const [svg, width] = sheet("compared-map", height, wanted ? width0 : undefined);
    const { scale, X, Y } = fit([compared.x.subarray(a, b + 1)], [compared.y.subarray(a, b + 1)], width, height, 30);
    const inside = clipped(svg, 0, 0, width, height);
    const [c, d] = part(compared.fix_t);
    let dots = "";
    for (let i = c; i <= d; i++) dots += `M${X(compared.fix_x[i]).toFixed(1)} ${Y(compared.fix_y[i]).toFixed(1)}h0`;
    make("path", { d: dots, class: "fixes" }, inside); // beads wider than the lines, so that neither hides the other
    const tracks = [["baseline_", "line s4", "7 3"], ["", "line s0", ""]];
    for (const [name, look, dash] of tracks) if (compared[`${name}x`]) make("path", { d: trail(compared[`${name}x`], compared[`${name}y`], X, Y, a, b), class: look, "stroke-dasharray": dash }, inside);
    scaleBar(svg, scale, width, height);
    const speeds = [{ x: compared.t, y: compared.speed.map((v) => v * factor()), slot: 0, dash: "" }];
    if (compared.baseline_speed) speeds.unshift({ x: compared.t, y: compared.baseline_speed.map((v) => v * factor()), slot: 4, dash: "7 3" });
    const ours = speeds[speeds.length - 1].y, limits = extent([sureOnly(ours, compared.is_sure, a, b)], a, b);
    const cut = [...(speeds.length > 1 && !holds(limits, extent([speeds[0].y], a, b)) ? ["the baseline"] : []), ...(holds(limits, extent([ours], a, b)) ? [] : ["unsure parts"])];
    const title = `speed (${state.unit})${cut.length ? `; ${cut.join(" and ")} ${cut[0] === "the baseline" && cut.length === 1 ? "goes" : "go"} on beyond the frame` : ""}`;
    const wide = wanted ? width0 : room("compared-speed"), tall = grown(260, title, wide);
    const [plot, w] = sheet("compared-speed", tall + AXIS, wanted ? width0 : undefined);
    panel(plot, { top: 0, height: tall }, { x0: compared.t[a], x1: compared.t[b], width: w, title, series: speeds.map((s) => ({ ...s, span: [a, b] })), limits, least: 5 });
    bottomAxis(plot, compared.t[a], compared.t[b], w, tall, true);
  }
  function drawQuality(wanted) {
    if (!quality) return;
    const x1 = quality.t[quality.t.length - 1];
    const panels = [];
    if (quality.sigma) {
      panels.push({ title: "uncertainty (m, one sigma): position (solid), line on the track (dashed)", series: [{ x: quality.t, y: quality.sigma, slot: 0, dash: "" }, { x: quality.t, y: quality.sigma_track, slot: 1, dash: "7 3" }] });
    }
    if (quality.fix_t) panels.push({ title: "each fix: residual in metres (orange: little weight)", series: [{ x: quality.fix_t, y: quality.residual, slot: 0, dots: true }, { x: quality.fix_t, y: quality.doubted, slot: 1, dots: true }], cap: quality.cap });
    if (quality.interval) panels.push({ title: "seconds between fixes", series: [{ x: quality.fix_all_t, y: quality.interval, slot: 2, dots: true }] });
    const wide = room("quality-time", wanted), heights = panels.map((p) => grown(150, p.title, wide));
    const total = heights.reduce((sum, height) => sum + height, 0);
    const [svg, width] = sheet("quality-time", total + AXIS, wanted);
    let top = 0;
    panels.forEach((p, i) => {
      const [, high] = extent(p.series.map((s) => s.y));
      panel(svg, { top, height: heights[i] }, { x0: 0, x1, width, title: p.title, series: p.series, limits: [0, p.cap || high], floor: 0, least: 0.01 });
      top += heights[i];
    });
    bottomAxis(svg, 0, x1, width, total, true);
  }

  // ---- state ----
  function readout(at) {
    const body = place("readout");
    body.replaceChildren();
    for (const [lap, slot] of state.slots) {
      const row = html("tr", "", body);
      const name = html("td", "", row);
      name.appendChild(swatch(slot));
      html("span", ` ${data.laps[lap].name}`, name);
      html("td", fixed(traces.speed[lap][at] * factor(), 1), row);
      for (const [key, sigma, digits] of [["delta", "delta_sigma", 3], ["offset", "offset_sigma", 2]]) {
        const value = traces[key] ? traces[key][lap][at] : NaN;
        const error = traces[sigma] ? traces[sigma][lap][at] : NaN;
        const isItself = key === "delta" && data.laps[lap].is_against;
        html("td", isItself ? "–" : fixed(value, digits, true) + (Number.isFinite(value + error) && error > 0 ? ` ± ${fixed(error, digits)}` : ""), row);
      }
      for (const key of ["longitudinal", "sideways"]) html("td", fixed(traces[key] ? traces[key][lap][at] / 9.80665 : NaN, 2, true), row);
      for (const c of data.channels || []) html("td", fixed(traces[c.name] ? traces[c.name][lap][at] : NaN, 1), row);
    }
    place("where").textContent = along(grid[at]);
    place("cursor").value = at;
    const lap = state.coloured;
    place("cursor").setAttribute("aria-valuetext", `${along(grid[at])}, ${fixed(traces.speed[lap][at] * factor(), 1)} ${state.unit}`);
  }
  function moveTo(at) {
    state.at = Math.min(grid.length - 1, Math.max(0, at));
    for (const move of cursors) move(state.at);
    readout(state.at);
  }
  function show(range) {
    state.range = range[1] - range[0] > 3 ? range : [0, grid.length - 1];
    const whole = state.range[0] === 0 && state.range[1] === grid.length - 1;
    if (whole) place("stretch").value = "whole";
    else if (range.named !== true) place("stretch").value = "own";
    if (state.at < state.range[0] || state.at > state.range[1]) state.at = state.range[0];
    draw();
  }
  function pick(lap, wanted) {
    if (wanted) {
      let slot = 0;
      while ([...state.slots.values()].includes(slot)) slot++;
      state.slots.set(lap, slot);
      state.coloured = lap;
    } else if (state.slots.size > 1) {
      state.slots.delete(lap);
      if (state.coloured === lap) state.coloured = [...state.slots.keys()].pop();
    }
    showPicked();
    draw();
  }
  function showPicked() {
    for (const box of document.querySelectorAll("#laps-picked input")) {
      const lap = Number(box.value);
      box.checked = state.slots.has(lap);
      box.parentNode.classList.toggle("unpicked", !box.checked);
      box.parentNode.querySelector("svg").replaceWith(swatch(state.slots.get(lap)));
    }
    const list = place("coloured");
    list.replaceChildren();
    for (const lap of state.slots.keys()) {
      const option = html("option", data.laps[lap].name, list);
      option.value = lap;
      option.selected = lap === state.coloured;
    }
  }
  function draw(wanted) {
    const width = typeof wanted === "number" ? wanted : undefined;
    cursors.length = 0;
    drawMap(width);
    drawTraces(width);
    drawCircle(width);
    drawCompared(width);
    drawQuality(width);
    for (const cell of document.querySelectorAll("[data-mps]")) cell.textContent = fixed(Number(cell.dataset.mps) * factor(), Number(cell.dataset.digits ?? 1));
    for (const cell of document.querySelectorAll(".speed-unit")) cell.textContent = state.unit;
    moveTo(state.at);
  }
  function remember(key, value) {
    try { localStorage.setItem(key, value); } catch { /* a page from disk may not be allowed to */ }
  }
  function remembered(key) {
    try { return localStorage.getItem(key); } catch { return null; }
  }
  function keys(event) {
    const step = event.shiftKey ? 10 : 1;
    const moves = { ArrowLeft: state.at - step, ArrowRight: state.at + step, ArrowDown: state.at - step, ArrowUp: state.at + step, Home: state.range[0], End: state.range[1], PageDown: state.at - 25, PageUp: state.at + 25 };
    if (event.key in moves) moveTo(moves[event.key]);
    else if (event.key === "+" || event.key === "-") {
      const half = Math.max(4, Math.round(((state.range[1] - state.range[0]) / 2) * (event.key === "+" ? 0.5 : 2)));
      show([Math.max(0, state.at - half), Math.min(grid.length - 1, state.at + half)]);
    } else if (event.key === "Escape") show([0, grid.length - 1]);
    else return;
    event.preventDefault();
  }
  function control(id, kind, listener) {
    const node = place(id);
    if (node) node.addEventListener(kind, (event) => listener(event.target.value, event));
    return node;
  }

  // ---- begin ----
  for (const box of document.querySelectorAll("#laps-picked input")) box.addEventListener("change", () => pick(Number(box.value), box.checked));
  control("coloured", "change", (value) => { state.coloured = Number(value); draw(); });
  control("units", "change", (value) => { state.unit = value; remember("kart-report-units", value); draw(); });
  control("stretch", "change", (value) => {
    if (value === "own") return;
    const part = data.stretches[Number(value)];
    const range = part ? [nearest(grid, part[0]), nearest(grid, part[1])] : [0, grid.length - 1];
    range.named = true;
    show(range);
  });
  for (const button of document.querySelectorAll("button.look")) button.addEventListener("click", () => {
    const laps = button.dataset.laps.split(" ").map(Number);
    state.slots = new Map(laps.map((lap, slot) => [lap, slot]));
    state.coloured = laps[laps.length - 1];
    showPicked();
    show([nearest(grid, Number(button.dataset.from)), nearest(grid, Number(button.dataset.to))]);
    place("driving").scrollIntoView();
  });
  place("cursor").addEventListener("keydown", keys);
  control("cursor", "input", (value) => moveTo(Number(value)));
  for (const lap of data.first) state.slots.set(lap, state.slots.size);
  if (remembered("kart-report-units") in UNITS) { state.unit = remembered("kart-report-units"); place("units").value = state.unit; }
  showPicked();
  draw();
  let waiting = 0, printing = false, wide = document.body.clientWidth;
  new ResizeObserver(() => {
    if (printing || document.body.clientWidth === wide) return;
    wide = document.body.clientWidth;
    cancelAnimationFrame(waiting);
    waiting = requestAnimationFrame(() => draw());
  }).observe(document.body);
  addEventListener("beforeprint", () => { printing = true; draw(700); });
  addEventListener("afterprint", () => { printing = false; draw(); });
})();
