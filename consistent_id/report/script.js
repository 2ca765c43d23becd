"use strict";
// Zooming of torque plots, turning of robots, unfolding for print. Without it, all is
// there, only still. No name in the page's data is ever made into markup.
(() => {
  document.documentElement.classList.add("scripted");
  const SVG = "http://www.w3.org/2000/svg";
  const LEFT = 46, RIGHT = 8, TOP = 8;

  const numbers = (record) => {
    const bytes = Uint8Array.from(atob(record.data), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    const found = new Float64Array(bytes.length / 2);
    for (let i = 0; i < found.length; i++) {
      found[i] = record.low + record.step * view.getUint16(2 * i, true);
    }
    return found;
  };

  const ticks = (low, high, most) => {
    const rough = (high - low) / most;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
    const found = [];
    for (let i = Math.ceil(low / step); i <= Math.floor(high / step); i++) {
      found.push(Number((i * step).toPrecision(12)));
    }
    return found;
  };

  // First place in rising numbers that is not below a value.
  const place = (rising, value) => {
    let low = 0, high = rising.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (rising[middle] < value) low = middle + 1; else high = middle;
    }
    return low;
  };

  // The extremes of every column of pixels: what is drawn looks like all of it.
  const curve = (time, values, first, last, x, y, columns) => {
    const size = Math.max(1, Math.floor((last - first) / columns));
    const points = [];
    for (let i = first; i < last; i += size) {
      let least = i, most = i;
      for (let k = i; k < Math.min(i + size, last); k++) {
        if (values[k] < values[least]) least = k;
        if (values[k] > values[most]) most = k;
      }
      const pair = least < most ? [least, most] : [most, least];
      for (const k of least === most ? [least] : pair) {
        points.push(x(time[k]).toFixed(1) + " " + y(values[k]).toFixed(1));
      }
    }
    return points.length ? "M" + points.join("L") : "";
  };

  const add = (parent, name, attributes, content) => {
    const made = document.createElementNS(SVG, name);
    for (const key in attributes) made.setAttribute(key, attributes[key]);
    if (content !== undefined) made.textContent = content;
    parent.append(made);
    return made;
  };

  const draw = (panel, time, span) => {
    const width = Math.max(280, panel.box.clientWidth || 720);
    const { height, bottom } = panel;
    const [from, to] = span;
    const first = Math.max(0, place(time, from) - 1);
    const last = Math.min(time.length, place(time, to) + 2);
    let low = Infinity, high = -Infinity;
    for (const { values } of panel.traces) {
      for (let i = first; i < last; i++) {
        if (values[i] < low) low = values[i];
        if (values[i] > high) high = values[i];
      }
    }
    const margin = 0.05 * (high - low || Math.abs(high) || 1);
    low -= margin; high += margin;
    const x = (t) => LEFT + (t - from) / (to - from) * (width - LEFT - RIGHT);
    const y = (v) => height - bottom - (v - low) / (high - low) * (height - TOP - bottom);
    const svg = panel.svg;
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    for (const t of ticks(from, to, width < 450 ? 4 : 8)) {
      add(svg, "path", { d: `M${x(t)} ${TOP}V${height - bottom}`, class: "grid" });
      if (panel.below) add(svg, "text", { x: x(t), y: height - bottom + 13 }, String(t));
    }
    for (const v of ticks(low, high, 4)) {
      add(svg, "path", { d: `M${LEFT} ${y(v)}H${width - RIGHT}`, class: v === 0 ? "zero" : "grid" });
      add(svg, "text", { x: LEFT - 4, y: y(v) + 3.5, class: "end" }, String(v));
    }
    // Curves go on beyond the axes by a sample at either end: an inner picture clips.
    const inner = width - LEFT - RIGHT;
    const area = { x: LEFT, y: 0, width: inner, height, viewBox: `${LEFT} 0 ${inner} ${height}` };
    const inside = add(svg, "svg", area);
    for (const { name, values } of panel.traces) {
      const d = curve(time, values, first, last, x, y, inner);
      add(inside, "path", { d, class: "curve " + name });
    }
    const middle = (height - bottom) / 2 + 4;
    add(svg, "text", { transform: `translate(10 ${middle})rotate(-90)` }, panel.unit);
    if (panel.below) add(svg, "text", { x: width / 2, y: height - 3 }, "time [s]");
  };

  const zoomable = (group) => {
    const time = numbers(JSON.parse(group.querySelector(".times").textContent));
    const whole = [time[0], time[time.length - 1]];
    let span = whole, asked = false;
    const panels = [...group.querySelectorAll(".zoom")].map((box) => ({
      box,
      svg: box.querySelector("svg"),
      unit: box.dataset.unit,
      height: Number(box.dataset.height),
      bottom: Number(box.dataset.bottom),
      below: box.classList.contains("below"),
      traces: JSON.parse(box.querySelector(".trace").textContent)
        .map((record) => ({ name: record.name, values: numbers(record) })),
    }));
    const redraw = () => {
      if (asked) return;
      asked = true;
      requestAnimationFrame(() => {
        asked = false;
        for (const panel of panels) draw(panel, time, span);
      });
    };
    const show = (from, to) => {
      const least = 10 * (whole[1] - whole[0]) / time.length;
      const length = Math.min(Math.max(to - from, least), whole[1] - whole[0]);
      const start = Math.min(Math.max(from, whole[0]), whole[1] - length);
      span = [start, start + length];
      group.dataset.span = span.map((t) => t.toFixed(4)).join(" ");
      redraw();
    };
    const steps = {
      in: () => show(span[0] + (span[1] - span[0]) / 4, span[1] - (span[1] - span[0]) / 4),
      out: () => show(span[0] - (span[1] - span[0]) / 2, span[1] + (span[1] - span[0]) / 2),
      left: () => show(span[0] - (span[1] - span[0]) / 2, span[1] - (span[1] - span[0]) / 2),
      right: () => show(span[0] + (span[1] - span[0]) / 2, span[1] + (span[1] - span[0]) / 2),
      all: () => show(...whole),
    };
    for (const button of group.parentElement.querySelectorAll("[data-zoom]")) {
      button.addEventListener("click", steps[button.dataset.zoom]);
    }
    for (const panel of panels) dragged(panel.box, () => span, show, steps.all);
    new ResizeObserver(redraw).observe(group);
    for (const panel of panels) draw(panel, time, span);
  };

  const dragged = (box, span, show, all) => {
    let start = null, mark = null;
    const at = (event) => {
      const edge = box.getBoundingClientRect();
      const inner = edge.width - LEFT - RIGHT;
      return Math.min(Math.max((event.clientX - edge.left - LEFT) / inner, 0), 1);
    };
    const left = (share, width) => LEFT + share * (width - LEFT - RIGHT) + "px";
    box.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      start = at(event);
      box.setPointerCapture(event.pointerId);
    });
    box.addEventListener("pointermove", (event) => {
      if (start === null) return;
      if (!mark) { mark = document.createElement("div"); mark.className = "chosen"; box.append(mark); }
      const ends = [start, at(event)].sort((a, b) => a - b);
      mark.style.left = left(ends[0], box.clientWidth);
      mark.style.right = box.clientWidth - parseFloat(left(ends[1], box.clientWidth)) + "px";
    });
    const end = (event) => {
      if (start === null) return;
      const ends = [start, at(event)].sort((a, b) => a - b);
      start = null;
      if (mark) { mark.remove(); mark = null; }
      if (event.type === "pointerup" && ends[1] - ends[0] > 0.01) {
        const [from, to] = span();
        show(from + ends[0] * (to - from), from + ends[1] * (to - from));
      }
    };
    box.addEventListener("pointerup", end);
    box.addEventListener("pointercancel", end);
    box.addEventListener("dblclick", all);
  };

  const floats = (text) => text.split(" ").map(Number);

  // As projection.py does; SVG counts downwards.
  const turned = (svg, azimuth) => {
    const a = azimuth * Math.PI / 180, e = 20 * Math.PI / 180;
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    const scale = Number(svg.dataset.scale);
    const dot = (u, v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    const seen = (p) => [scale * dot(right, p), -scale * dot(up, p)];
    const set = (element, values) => {
      for (const key in values) element.setAttribute(key, values[key]);
    };
    for (const bone of svg.querySelectorAll("line")) {
      const p = floats(bone.dataset.p);
      const [x1, y1] = seen(p.slice(0, 3)), [x2, y2] = seen(p.slice(3));
      set(bone, { x1, y1, x2, y2 });
    }
    for (const joint of svg.querySelectorAll("circle")) {
      const [cx, cy] = seen(floats(joint.dataset.p));
      set(joint, { cx, cy });
    }
    for (const cross of svg.querySelectorAll(".place")) {
      set(cross, { transform: `translate(${seen(floats(cross.dataset.p)).join(" ")})` });
    }
    for (const body of svg.querySelectorAll("ellipse")) {
      const [xx, xy, xz, yy, yz, zz] = floats(body.dataset.q);
      const times = (v) => [dot([xx, xy, xz], v), dot([xy, yy, yz], v), dot([xz, yz, zz], v)];
      const A = dot(right, times(right)), B = dot(right, times(up)), C = dot(up, times(up));
      const root = Math.hypot((A - C) / 2, B), half = (A + C) / 2;
      const rx = Math.max(scale * Math.sqrt(Math.max(half + root, 0)), 1.5);
      const ry = Math.max(scale * Math.sqrt(Math.max(half - root, 0)), 1.5);
      const angle = -Math.atan2(2 * B, A - C) / 2 * 180 / Math.PI;
      const [cx, cy] = seen(floats(body.dataset.p));
      set(body, { cx, cy, rx, ry, transform: `rotate(${angle} ${cx} ${cy})` });
    }
  };

  for (const group of document.querySelectorAll(".zoomable")) zoomable(group);
  for (const slider of document.querySelectorAll(".turn input")) {
    slider.addEventListener("input", () => {
      for (const svg of document.querySelectorAll(".robot")) turned(svg, Number(slider.value));
    });
  }
  let closed = [];
  addEventListener("beforeprint", () => {
    closed = [...document.querySelectorAll("details:not([open])")];
    for (const folded of closed) folded.open = true;
  });
  addEventListener("afterprint", () => { for (const folded of closed) folded.open = false; });
})();
