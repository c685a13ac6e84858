// The page: reads the run, and connects scene, side panel and time line.
const SECONDS_SHOWN = 30; // for a whole flight, at the speed that is chosen first
const SPEEDS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
const TEXT_PERIOD = 100; // of texts and cursors in play [ms]
const MOST_TRAILS = 400000; // vehicles times instants, up to which trails are shown at first
const find = (id) => document.getElementById(id);

class Player {
  constructor(run) {
    this.run = run;
    this.time = run.start;
    this.isPlaying = false;
    this.view = new SwarmView(find("canvas"), find("labels"), run);
    this.painter = new Painter(run);
    this.curves = run.series.map((series) => new Curve(run, series, find("series")));
    this.lanes = new Lanes(run, find("lanes"), find("names"), (time) => this.format(time));
    this.options = { paths: run.agents * run.time.length > MOST_TRAILS ? "none" : "trail" };
    this.fillPage();
    this.connect();
    this.view.render();
    this.lanes.draw();
    this.lookFrom(run.flat ? 0 : run.viewpoint.views.length - 1);
    this.seek(run.start);
    requestAnimationFrame((now) => this.advance(now));
  }

  fillPage() {
    const { run, view } = this, { targets, links, colorings } = run;
    const thinned = run.every > 1 ? `one instant of ${run.every}; ` : "";
    find("title").textContent = run.title;
    find("about").textContent = [
      `${run.system}, ${plural(run.agents, "vehicle")}, ${this.format(run.end - run.start)}`,
      `sato ${run.version}`].join("; ");
    find("scale").textContent = `grid: ${rounded(view.spacing)} m; ${thinned}positions within ` +
      `${run.error.toPrecision(2)} m, cubic between instants; bodies touch at the required distance, but are ≥ ${LEAST_SIZE} px wide`;
    colorings.forEach(({ name }, i) => find("coloring").append(element("option", { value: i }, name)));
    const toggle = (name, text, isOn) => {
      const box = element("input", { type: "checkbox", id: `show-${name}` });
      this.options[name] = box.checked = isOn;
      const label = element("label");
      label.append(box, ` ${text}`);
      find("toggles").append(label);
      box.addEventListener("change", () => this.set(name, box.checked));
    };
    const reach = links.radius === null ? "" : `, ${rounded(links.radius)} m`;
    toggle("links", `links: ${links.name}${reach}`, run.agents <= 300);
    toggle("targets", `${targets.name}s`, true);
    if (run.obstacles.length) toggle("obstacles", plural(run.obstacles.length, "obstacle"), true);
    if (run.status.includes(LOST)) toggle("lost", "lost vehicles", true);
    toggle("grid", "grid", true);
    find("paths").value = this.options.paths;
    run.viewpoint.views.forEach(([name], i) => {
      const button = element("button", { title: `key ${i + 1}` }, name);
      button.addEventListener("click", () => this.lookFrom(i));
      find("views").append(button);
    });
    find("follow").append(element("option", { value: -1 }, "no vehicle"));
    for (let i = 0; i < run.agents; i++) {
      find("follow").append(element("option", { value: i }, `vehicle ${i}`));
    }
    const wanted = (run.end - run.start) / SECONDS_SHOWN;
    this.speed = SPEEDS.reduce((a, b) => (Math.abs(Math.log(b / wanted)) < Math.abs(Math.log(a / wanted)) ? b : a));
    for (const speed of SPEEDS) find("speed").append(element("option", { value: speed }, `${speed} ×`));
    find("speed").value = this.speed;
    Object.assign(find("seek"), { min: run.start, max: run.end, step: "any", value: run.start });
  }

  connect() {
    const { run, view, lanes } = this, canvas = find("canvas"), drawing = find("lanes");
    const on = (id, type, action) => find(id).addEventListener(type, action);
    on("play", "click", () => this.toggle());
    on("seek", "input", () => this.seek(Number(find("seek").value)));
    on("speed", "change", () => (this.speed = Number(find("speed").value)));
    on("coloring", "change", () => this.refresh());
    on("paths", "change", () => this.set("paths", find("paths").value));
    on("follow", "change", () => this.follow(Number(find("follow").value)));
    let pressed = null;
    canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
    canvas.addEventListener("pointerup", (event) => {
      if (!pressed || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4) return;
      const { left, top } = canvas.getBoundingClientRect();
      const agent = view.pick(event.clientX - left, event.clientY - top);
      if (agent >= 0) this.follow(agent);
    });
    const here = (event) => lanes.find(event.offsetX, event.offsetY);
    drawing.addEventListener("pointermove", (event) => {
      const found = here(event);
      find("track").title = find("event").textContent = found ? lanes.describe(found) : "";
    });
    drawing.addEventListener("click", (event) => {
      const share = (event.offsetX - 8) / (drawing.clientWidth - 16);
      this.seek(here(event)?.time ?? run.start + share * (run.end - run.start));
    });
    // After a click, keys act on the player again.
    addEventListener("click", ({ target, detail }) => detail && target.matches("button, input") && target.blur());
    addEventListener("resize", () => (lanes.draw(), this.refresh()));
    addEventListener("keydown", (event) => this.press(event));
  }

  press(event) {
    const { run } = this, isField = event.target.matches("select, input[type=checkbox]");
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const step = (event.shiftKey ? 10 : 1) * (run.end - run.start) / Math.max(run.time.length - 1, 1);
    const actions = {
      ArrowRight: () => this.seek(this.time + step),
      ArrowLeft: () => this.seek(this.time - step),
      Home: () => this.seek(run.start),
      End: () => this.seek(run.end),
      "]": () => this.jump(1),
      "[": () => this.jump(-1),
      Escape: () => this.follow(-1),
    };
    const view = run.viewpoint.views[Number(event.key) - 1];
    if (event.key === " " && !event.target.matches("button, select, input[type=checkbox]")) this.toggle();
    else if (event.key in actions && !isField) actions[event.key]();
    else if (view && !isField) this.lookFrom(Number(event.key) - 1);
    else return;
    event.preventDefault();
  }

  jump(direction) {
    const later = this.run.events.filter((event) => direction * (event.time - this.time) > 1e-6);
    const times = later.map((event) => direction * event.time);
    if (!times.length) return;
    const time = direction * Math.min(...times);
    this.seek(time);
    const met = this.run.events.filter((event) => event.time === time);
    find("event").textContent = met.map((event) => this.lanes.describe(event)).join("; ");
  }

  format(time) {
    const { time_unit: unit } = this.run.viewpoint;
    return unit === "min" ? `${(time / 60).toFixed(2)} min` : `${Number(time.toFixed(2))} s`;
  }

  lookFrom(number) {
    this.follow(-1);
    this.view.look(number);
  }

  set(name, value) {
    this.options[name] = value;
    this.refresh();
  }

  follow(agent) {
    this.view.follow(agent);
    find("follow").value = agent;
    this.refresh();
  }

  toggle() {
    if (!this.isPlaying && this.time >= this.run.end) this.time = this.run.start;
    this.isPlaying = !this.isPlaying;
    this.refresh();
    find("play").textContent = this.isPlaying ? "Pause" : "Play";
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.run.start), this.run.end);
    this.refresh();
  }

  advance(now) {
    const passed = Math.min((now - (this.now ?? now)) / 1000, 0.25);
    this.now = now;
    if (this.isPlaying) {
      this.time = Math.min(this.time + this.speed * passed, this.run.end);
      this.refresh(now - (this.told ?? 0) >= TEXT_PERIOD);
      if (this.time >= this.run.end) this.toggle();
    }
    this.view.render();
    requestAnimationFrame((later) => this.advance(later));
  }

  // Show the time. Browsers take longer to draw texts than bodies, so play leaves them out.
  refresh(tells = true) {
    const { run, time, view, painter } = this, k = lastUntil(run.time, time);
    const coloring = run.colorings[find("coloring").value];
    painter.paint(coloring, k);
    view.show(time, painter.colors, { ...this.options, colorsTargets: coloring.is_target });
    if (!tells) return;
    this.told = this.now;
    find("legend").replaceChildren(...painter.legend(coloring, k, this.options.lost));
    find("details").textContent = this.describe(view.followed, k);
    const share = shareOf(run, time);
    for (const curve of this.curves) curve.show(share, k);
    this.lanes.cursor.move(share);
    find("seek").value = time;
    find("seek").setAttribute("aria-valuetext", this.format(time));
    find("time").textContent = `${this.format(time)} of ${this.format(run.end)}`;
  }

  describe(agent, k) {
    const { run } = this, here = k * run.agents + agent;
    if (agent < 0) return "Click a vehicle to follow it.";
    const status = run.status[here];
    const lines = status === ABSENT ? ["not there"] : status === LOST ? ["lost"] : [];
    for (const { name, unit, values, categories } of run.colorings) {
      const value = values[here];
      if (Number.isNaN(value)) continue;
      lines.push(`${name}: ${categories.length ? categories[value][0] : withUnit(value, unit)}`);
    }
    return lines.join("\n");
  }
}

try {
  window.player = new Player(await readRun(find("data").textContent));
} catch (error) {
  const isDrawn = document.createElement("canvas").getContext("webgl2");
  find("problem").textContent = isDrawn
    ? `This page cannot be shown: ${error.message}`
    : "This browser cannot draw in three dimensions (WebGL 2); a recent one would do.";
}
