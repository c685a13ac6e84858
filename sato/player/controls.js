// Colors, curves and the time line beside the scene.
const RAMP = ["#440154", "#3b528b", "#21918c", "#5ec962", "#e3d51c"];
const NAMESPACE = "http://www.w3.org/2000/svg";
const EVENT_COLORS = { loss: "#d55e00", reset: "#d55e00", join: "#009e73", arrival: "#009e73" };
const BROKEN_COLOR = "#e6007e", BROKEN_SHARE = 0.02; // of the flight, about a broken promise
const isBroken = (kind) => kind.startsWith("broken: ");
const colorOf = (kind) => (isBroken(kind) ? BROKEN_COLOR : Object.hasOwn(EVENT_COLORS, kind) && EVENT_COLORS[kind]);

function element(name, attributes = {}, text = "") {
  const isDrawing = ["svg", "path", "rect", "line", "text", "g"].includes(name);
  const found = isDrawing ? document.createElementNS(NAMESPACE, name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) found.setAttribute(key, value);
  if (text) found.textContent = text;
  return found;
}

const shareOf = (run, time) => (time - run.start) / (run.end - run.start || 1);
const plural = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
const rounded = (value) => String(Number(value.toPrecision(4)));
const withUnit = (value, unit) => `${rounded(value)}${unit ? ` ${unit}` : ""}`;

// The range of a scale: what is far above nearly all values is shown as the highest.
function findRange(values) {
  const known = values.filter((value) => !Number.isNaN(value)).sort();
  if (!known.length) return [0, 1, false];
  const low = known[0], high = known[known.length - 1];
  const most = known[Math.floor(0.98 * (known.length - 1))];
  return high - low > 1.5 * (most - low) && most > low ? [low, most, true] : [low, high, false];
}

class Painter {
  constructor(run) {
    this.run = run;
    this.colors = new Float32Array(3 * run.agents);
    this.ramp = RAMP.map((color) => new THREE.Color(color));
  }

  // Colors of all vehicles at an instant; they change from one to the next only.
  paint(coloring, k) {
    if (this.coloring === coloring && this.instant === k) return;
    Object.assign(this, { coloring, instant: k });
    const { run, colors } = this, n = run.agents, color = new THREE.Color();
    const isScale = !coloring.is_target && !coloring.categories.length;
    if (isScale) coloring.range ??= findRange(coloring.values);
    const palette = coloring.categories.map(([, name]) => new THREE.Color(name));
    for (let i = 0; i < n; i++) {
      const value = coloring.values[k * n + i];
      if (run.status[k * n + i] === LOST || Number.isNaN(value)) color.set(GRAY);
      else if (coloring.is_target) color.setHSL((value * 0.618034) % 1, 0.7, 0.3 + 0.09 * (value % 3));
      else if (palette.length) color.copy(palette[value]);
      else this.pick(coloring.range, value, color);
      color.toArray(colors, 3 * i);
    }
    const near = (run.end - run.start) * BROKEN_SHARE;
    for (const { kind, time, agents } of run.events) {
      if (!isBroken(kind) || Math.abs(run.time[k] - time) > near) continue;
      for (const i of agents) color.set(BROKEN_COLOR).toArray(colors, 3 * i);
    }
  }

  pick([low, high], value, color) {
    const at = Math.min(Math.max((value - low) / (high - low || 1), 0), 1) * (RAMP.length - 1);
    const k = Math.min(Math.floor(at), RAMP.length - 2);
    color.lerpColors(this.ramp[k], this.ramp[k + 1], at - k);
  }

  legend(coloring, k, isLostShown) {
    const { run } = this, n = run.agents, rows = [], counts = new Map();
    const at = (i) => coloring.values[k * n + i];
    let lost = 0;
    for (let i = 0; i < n; i++) {
      if (run.status[k * n + i] === LOST) lost++;
      else if (!Number.isNaN(at(i))) counts.set(at(i), (counts.get(at(i)) || 0) + 1);
    }
    const swatch = (color, text) => {
      const row = element("span", {}, text);
      row.prepend(element("i", { style: `background: ${color}` }));
      rows.push(row);
    };
    coloring.categories.forEach(([name, color], c) =>
      counts.has(c) && swatch(color, `${name}: ${counts.get(c)}`));
    if (coloring.is_target) {
      rows.push(element("span", { class: "wide" }, `as the ${coloring.name} that it holds`));
    } else if (!coloring.categories.length) {
      const [low, high, isCut] = coloring.range, { unit } = coloring;
      const ends = element("div", { class: "wide ends" });
      ends.append(element("span", {}, withUnit(low, unit)),
        element("span", {}, `${isCut ? "≥ " : ""}${withUnit(high, unit)}`));
      rows.push(element("div", { class: "wide ramp",
        style: `background: linear-gradient(to right, ${RAMP.join(",")})` }), ends);
    }
    if (lost && isLostShown) swatch(GRAY, `lost: ${lost}`);
    return rows;
  }
}

// A line at a share of the width; as it is only moved, nothing below is drawn again.
class Cursor {
  constructor(parent) {
    this.line = element("div", { class: "cursor" });
    const frame = element("div", { class: "cursors" });
    frame.append(this.line);
    parent.append(frame);
  }

  move(share) {
    this.line.style.transform = `translateX(${(100 * share).toFixed(2)}%)`;
  }
}

// A curve over time with the least that is allowed, and a cursor.
class Curve {
  constructor(run, series, parent) {
    this.series = series;
    this.heading = element("h2");
    const svg = element("svg", { viewBox: "0 0 240 84", preserveAspectRatio: "none" });
    const known = Array.from(series.values).filter((value) => !Number.isNaN(value));
    const top = 1.08 * known.reduce((a, b) => Math.max(a, b), series.limit) || 1;
    const x = (t) => 26 + 214 * shareOf(run, t);
    const y = (value) => 78 - 72 * value / top;
    let path = "", isDrawing = false;
    series.values.forEach((value, k) => {
      const t = run.time[k], next = run.time[Math.min(k + 1, run.time.length - 1)];
      if (!Number.isNaN(value)) {
        path += `${isDrawing ? "L" : "M"}${x(t).toFixed(1)} ${y(value).toFixed(1)}`;
        if (series.is_held) path += `H${x(next).toFixed(1)}`;
      }
      isDrawing = !Number.isNaN(value);
    });
    const level = y(series.limit);
    svg.append(
      element("path", { d: "M26 4V78H240", stroke: "#888", fill: "none" }),
      element("path", { d: `M26 ${level}H240`, stroke: "#d55e00", "stroke-dasharray": "4 3" }),
      element("path", { d: path, stroke: "#0072b2", fill: "none", "stroke-width": 1.2 }),
      element("text", { x: 24, y: 12, "text-anchor": "end" }, rounded(top / 1.08)),
      element("text", { x: 24, y: 80, "text-anchor": "end" }, "0"),
      element("text", { x: 238, y: level < 66 ? level + 11 : level - 3, "text-anchor": "end" },
        `${series.limit_name} ${withUnit(series.limit, series.unit)}`),
    );
    const curve = element("div", { class: "curve" });
    curve.append(svg);
    parent.append(this.heading, curve);
    this.cursor = new Cursor(curve);
  }

  show(share, k) {
    const { series } = this, value = series.values[k];
    const text = Number.isNaN(value) ? "none" : withUnit(value, series.unit);
    this.heading.textContent = `${series.name}: ${text}`;
    this.cursor.move(share);
  }
}

// Stages and events below the slider, a row a kind.
class Lanes {
  constructor(run, svg, names, format) {
    Object.assign(this, { run, svg, format });
    const kinds = [...new Set(run.events.map((event) => event.kind))];
    this.rows = kinds.sort((a, b) => (colorOf(a) ? -1 : 0) - (colorOf(b) ? -1 : 0));
    for (const name of ["", ...this.rows]) names.append(element("div", {}, name.replaceAll("_", " ")));
    svg.style.height = `${13 * (this.rows.length + 1)}px`;
    this.cursor = new Cursor(svg.parentElement);
  }

  draw() {
    const { run, svg } = this, wide = svg.clientWidth - 16; // the slider's thumb is 16 px wide
    this.x = (time) => 8 + wide * shareOf(run, time);
    svg.replaceChildren();
    run.stages.forEach(([start, name], s) => {
      const end = s + 1 < run.stages.length ? run.stages[s + 1][0] : run.end;
      const [x, next] = [this.x(start), this.x(end)];
      svg.append(element("rect", { x, y: 0, width: Math.max(next - x - 1, 0), height: 12, fill: "#e8eef2" }));
      if (next - x > 7 * name.length) svg.append(element("text", { x: x + 5, y: 9.5 }, name));
    });
    this.rows.forEach((kind, row) => {
      const top = 13 * (row + 1), own = run.events.filter((event) => event.kind === kind);
      const ticks = own.map(({ time }) => `M${this.x(time).toFixed(1)} ${top + 2}v9`).join("");
      svg.append(
        element("line", { x1: 8, x2: 8 + wide, y1: top + 6.5, y2: top + 6.5, stroke: "#eee" }),
        element("path", { d: ticks, "stroke-width": 2, stroke: colorOf(kind) || "#6b7c88" }),
      );
    });
  }

  describe({ kind, time, agents, count }) {
    const listed = agents.join(", ") + (count > agents.length ? ", …" : "");
    const what = count ? `, ${plural(count, "vehicle")}: ${listed}` : "";
    return `${this.format(time)}: ${kind.replaceAll("_", " ")}${what}`;
  }

  // The event at a place of the drawing, or undefined.
  find(x, y) {
    const kind = this.rows[Math.floor(y / 13) - 1];
    const away = (event) => Math.abs(this.x(event.time) - x);
    return this.run.events.filter((event) => event.kind === kind && away(event) < 6)
      .sort((a, b) => away(a) - away(b))[0];
  }
}
