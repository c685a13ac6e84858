// The scene in three dimensions: bodies, links, targets, paths, obstacles, grid and axes.
const GRAY = "#8c8c8c", LINK = "#7d9bb0", TRAIL = "#8fa9ba", TARGET = "#a9a9a9", HELD = "#222222";
const FIELD = 30; // of view [deg]
const LEAST_SIZE = 5; // of a drawn body [px]
const MOST_LINKS = 60000;
const MOST_PATH_POINTS = 1e6;
const TRAIL_SHARE = 0.08; // of the flight, in the last part of a path

// Discs shaded as balls; the followed one has a ring. A size of zero hides one.
const BODY_VERTEX = `
  attribute vec3 tint; attribute float size; uniform float unit, least, chosen;
  varying vec3 color; varying float ring, edge; attribute float number;
  void main() {
    vec4 seen = modelViewMatrix * vec4(position, 1.0);
    ring = number == chosen ? 1.7 : 1.0;
    color = tint;
    gl_Position = size > 0.0 ? projectionMatrix * seen : vec4(2.0, 2.0, 2.0, 1.0);
    float wide = max(size * unit / -seen.z, least);
    edge = min(3.0 / wide, 1.0);
    gl_PointSize = ring * wide;
  }`;
const BODY_FRAGMENT = `
  varying vec3 color; varying float ring, edge;
  void main() {
    vec2 at = ring * (2.0 * gl_PointCoord - 1.0);
    float r = dot(at, at);
    if (r > 1.0 && (ring < 1.5 || r < 1.7 || r > 2.89)) discard;
    float soft = smoothstep(1.0, 1.0 - edge, sqrt(r));
    float depth = sqrt(max(1.0 - r, 0.0));
    float light = 0.62 + 0.38 * clamp(0.75 * depth - 0.45 * at.y - 0.35 * at.x, 0.0, 1.0);
    light *= mix(1.0, 0.75, smoothstep(0.7, 1.0, r));
    gl_FragColor = r > 1.0 ? vec4(vec3(0.1), 1.0) : vec4(color * light, soft);
  }`;
const CROSS_FRAGMENT = `
  varying vec3 color; varying float ring;
  void main() {
    vec2 at = abs(2.0 * gl_PointCoord - 1.0);
    if (abs(at.x - at.y) > 0.22) discard;
    gl_FragColor = vec4(color, 1.0);
  }`;
const PATH_VERTEX = `
  attribute float time; varying float when;
  void main() {
    when = time;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }`;
const PATH_FRAGMENT = `
  uniform float now, span; uniform vec3 color; varying float when;
  void main() {
    float age = (now - when) / span;
    if (age < 0.0 || age > 1.0) discard;
    gl_FragColor = vec4(color, 0.85 * (1.0 - age));
  }`;

THREE.ColorManagement.enabled = false;

class SwarmView {
  constructor(canvas, labels, run) {
    Object.assign(this, { canvas, labels, run });
    this.isDirty = true;
    const [low, high] = run.bounds.map((corner) => new THREE.Vector3(...corner));
    const margin = Math.max(...run.diameter);
    this.low = low.subScalar(margin);
    this.high = high.addScalar(margin);
    this.middle = low.clone().add(high).multiplyScalar(0.5);
    this.extent = Math.max(...high.clone().sub(low).toArray());
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: run.agents <= 300 });
    this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace; // colors are written as given
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setClearColor("#fcfcfb");
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FIELD, 1, this.extent / 500, 100 * this.extent);
    this.camera.up.set(...run.viewpoint.up);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => (this.isDirty = true));
    this.controls.zoomToCursor = true;
    this.points = new Float32Array(3 * run.agents);
    this.isAlive = new Uint8Array(run.agents);
    this.texts = [];
    this.addGround();
    this.obstacles = run.obstacles.map((hull) => this.addObstacle(hull));
    this.links = this.addSegments(LINK, 0.55, 2);
    this.held = this.addSegments(HELD, 0.9, 3);
    this.targets = this.addMarks(run.targets.count, CROSS_FRAGMENT, 1, !run.flat);
    this.bodies = this.addMarks(run.agents, BODY_FRAGMENT, 4, true);
    this.pairs = [];
    this.followed = -1;
  }

  addMarks(count, fragmentShader, renderOrder, depthTest) {
    const geometry = new THREE.BufferGeometry();
    const attribute = (name, size) =>
      geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(count * size), size));
    ["position", "tint"].forEach((name) => attribute(name, 3));
    ["size", "number"].forEach((name) => attribute(name, 1));
    geometry.attributes.number.array.forEach((_, i, numbers) => (numbers[i] = i));
    const least = LEAST_SIZE * this.renderer.getPixelRatio();
    const uniforms = { unit: { value: 1 }, least: { value: least }, chosen: { value: -1 } };
    const material = new THREE.ShaderMaterial({
      vertexShader: BODY_VERTEX, fragmentShader, uniforms, transparent: true, depthTest,
    });
    return this.add(new THREE.Points(geometry, material), renderOrder);
  }

  addSegments(color, opacity, renderOrder) {
    const material = new THREE.LineBasicMaterial({
      color, opacity, transparent: true, depthWrite: false, depthTest: !this.run.flat,
    });
    return this.add(new THREE.LineSegments(new THREE.BufferGeometry(), material), renderOrder);
  }

  add(object, renderOrder) {
    object.frustumCulled = false;
    object.geometry.boundingSphere = new THREE.Sphere(this.middle, this.extent); // never computed
    object.renderOrder = renderOrder;
    this.scene.add(object);
    return object;
  }

  setSegments(object, coordinates, count = coordinates.length) {
    const { geometry } = object;
    if (!geometry.attributes.position || geometry.attributes.position.array.length < count) {
      const room = new Float32Array(Math.max(64, 2 * count));
      geometry.setAttribute("position", new THREE.BufferAttribute(room, 3));
    }
    geometry.attributes.position.array.set(coordinates);
    geometry.attributes.position.needsUpdate = true;
    geometry.setDrawRange(0, count / 3);
  }

  // A grid of round numbers, the axes at its corner or at the origin, and other directions.
  addGround() {
    const { low, high, extent, run } = this;
    const power = 10 ** Math.floor(Math.log10(extent / 4));
    this.spacing = power * [5, 2, 1].find((factor) => factor * power <= extent / 4);
    const [x0, y0] = [low.x, low.y].map((v) => Math.floor(v / this.spacing) * this.spacing);
    const [x1, y1] = [high.x, high.y].map((v) => Math.ceil(v / this.spacing) * this.spacing);
    const isSpace = run.viewpoint.arrows.length > 0;
    const z = isSpace || run.planar || low.z * high.z <= 0 ? 0 : low.z;
    const lines = [];
    for (let x = x0; x < x1 + extent / 1e6; x += this.spacing) lines.push(x, y0, z, x, y1, z);
    for (let y = y0; y < y1 + extent / 1e6; y += this.spacing) lines.push(x0, y, z, x1, y, z);
    this.grid = this.addSegments("#d4d4d4", 0.7, -1);
    this.setSegments(this.grid, lines);
    const own = [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].slice(0, run.flat ? 2 : 3);
    this.corner = new THREE.Vector3(low.x, low.y, z).subScalar(0.02 * extent).setZ(z);
    const from = isSpace ? new THREE.Vector3() : this.corner;
    for (const [name, direction] of isSpace ? run.viewpoint.arrows : own) {
      const tip = new THREE.Vector3(...direction).multiplyScalar(isSpace ? 0.2 * extent : 0.12 * extent);
      const arrow = this.addSegments("#444444", 0.9, 0);
      this.setSegments(arrow, [...from.toArray(), ...tip.add(from).toArray()]);
      this.addText(name, tip);
    }
  }

  addText(text, place) {
    const span = document.createElement("span");
    span.textContent = text;
    this.labels.append(span);
    this.texts.push({ span, place });
  }

  addObstacle({ vertices, triangles, velocity }) {
    if (!this.lights) {
      this.lights = [new THREE.HemisphereLight("#ffffff", "#b0b0b0", 2.2),
        new THREE.DirectionalLight("#ffffff", 1.2)];
      this.lights[1].position.set(-1, -2, 3);
      this.scene.add(...this.lights);
    }
    const corners = new Float32Array(triangles.flatMap((three) => three.flatMap((i) => vertices[i])));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    geometry.computeVertexNormals();
    const material = new THREE.MeshLambertMaterial({
      color: "#d6d2ca", opacity: 0.65, transparent: true, depthWrite: !this.run.flat,
    });
    const mesh = this.add(new THREE.Mesh(geometry, material), 0);
    mesh.userData.velocity = velocity;
    return mesh;
  }

  // All paths as one list of segments in the order of time, so that a part of it can be drawn.
  addPaths() {
    const { run } = this, n = run.agents, steps = run.time.length - 1;
    const room = Math.floor(MOST_PATH_POINTS / (n * Math.max(steps, 1)));
    const pieces = Math.max(1, Math.min(8, room));
    const instants = steps * pieces + 1, place = new Float32Array(3 * n);
    const position = new Float32Array(3 * n * instants), time = new Float32Array(n * instants);
    const index = new Uint32Array(2 * n * (instants - 1));
    this.pathTimes = [];
    for (let m = 0; m < instants; m++) {
      const k = Math.min(Math.floor(m / pieces), steps), share = m / pieces - k;
      const t = run.time[k] + (share ? share * (run.time[k + 1] - run.time[k]) : 0);
      this.pathTimes.push(t);
      interpolate(run, t, place);
      position.set(place, 3 * n * m);
      time.fill(t, n * m, n * (m + 1));
      if (m === instants - 1) break;
      for (let i = 0; i < n; i++) {
        const isThere = run.status[k * n + i] !== ABSENT;
        index[2 * (n * m + i)] = n * m + i;
        index[2 * (n * m + i) + 1] = n * (isThere ? m + 1 : m) + i;
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
    geometry.setAttribute("time", new THREE.BufferAttribute(time, 1));
    geometry.setIndex(new THREE.BufferAttribute(index, 1));
    const uniforms = { now: { value: 0 }, span: { value: 1 }, color: { value: new THREE.Color(TRAIL) } };
    const material = new THREE.ShaderMaterial({
      vertexShader: PATH_VERTEX, fragmentShader: PATH_FRAGMENT, uniforms,
      transparent: true, depthWrite: false, depthTest: !run.flat,
    });
    this.paths = this.add(new THREE.LineSegments(geometry, material), 1);
  }

  // Show an instant; colors are those of each vehicle, red, green and blue from 0 to 1.
  show(time, colors, options) {
    const { run, points, isAlive } = this, n = run.agents;
    const k = (this.instant = interpolate(run, time, points));
    const { size, tint, position } = this.bodies.geometry.attributes;
    for (let i = 0; i < n; i++) {
      const status = run.status[k * n + i], isKnown = !Number.isNaN(points[3 * i]);
      isAlive[i] = status !== ABSENT && status !== LOST && isKnown;
      const isShown = isAlive[i] || (status === LOST && options.lost && isKnown);
      size.array[i] = isShown ? run.diameter[i] : 0;
    }
    position.array.set(points);
    tint.array.set(colors);
    for (const one of [size, tint, position]) one.needsUpdate = true;
    this.bodies.material.uniforms.chosen.value = this.followed;
    this.showTargets(k, colors, options);
    this.showLinks(k, options);
    this.showPaths(time, options.paths);
    this.grid.visible = options.grid;
    for (const mesh of this.obstacles) {
      mesh.visible = options.obstacles;
      mesh.position.set(...mesh.userData.velocity).multiplyScalar(time);
    }
    this.keepFollowed();
    this.isDirty = true;
  }

  showTargets(k, colors, options) {
    const { run, targets } = this, { count, position, stage, held } = run.targets, n = run.agents;
    targets.visible = options.targets;
    this.held.visible = false;
    const place = targets.geometry.attributes, from = 3 * count * stage[k];
    place.position.array.set(position.subarray(from, from + 3 * count));
    const gray = new THREE.Color(TARGET);
    for (let j = 0; j < count; j++) {
      place.size.array[j] = Number.isNaN(place.position.array[3 * j]) ? 0 : 0.6 * run.diameter[0];
      gray.toArray(place.tint.array, 3 * j);
    }
    for (let i = 0; i < n; i++) {
      const j = held[k * n + i];
      if (j < 0 || !this.isAlive[i]) continue;
      if (options.colorsTargets) place.tint.array.set(colors.subarray(3 * i, 3 * i + 3), 3 * j);
      if (i !== this.followed || !place.size.array[j]) continue;
      const tip = place.position.array.subarray(3 * j, 3 * j + 3);
      this.setSegments(this.held, [...this.points.subarray(3 * i, 3 * i + 3), ...tip]);
      this.held.visible = options.targets;
    }
    for (const name of ["position", "size", "tint"]) place[name].needsUpdate = true;
  }

  showLinks(k, options) {
    const { run, points, pairs } = this, { radius, first, count } = run.links;
    this.links.visible = options.links;
    if (!options.links) return;
    if (radius !== null) findPairs(points, this.isAlive, radius, pairs);
    else {
      const entry = lastUntil(first, k);
      const from = 2 * count.slice(0, entry).reduce((a, b) => a + b, 0);
      this.pairs = Array.from(run.links.pairs.subarray(from, from + 2 * count[entry]));
    }
    const shown = Math.min(this.pairs.length, 2 * MOST_LINKS), ends = this.linkEnds ??= [];
    for (let m = 0; m < shown; m++) {
      for (let axis = 0; axis < 3; axis++) ends[3 * m + axis] = points[3 * this.pairs[m] + axis];
    }
    ends.length = 3 * shown;
    this.setSegments(this.links, ends);
    this.links.material.opacity = Math.min(Math.max(250 / shown, 0.12), 0.6);
  }

  showPaths(time, kind) {
    if (kind !== "none" && !this.paths) this.addPaths();
    if (!this.paths) return;
    const { run, pathTimes } = this, span = run.end - run.start || 1;
    const begin = kind === "trail" ? time - TRAIL_SHARE * span : run.start;
    const from = lastUntil(pathTimes, begin), to = lastUntil(pathTimes, time) + 1;
    this.paths.visible = kind !== "none";
    this.paths.geometry.setDrawRange(2 * run.agents * from, 2 * run.agents * (to - from));
    const { uniforms } = this.paths.material;
    uniforms.now.value = time;
    uniforms.span.value = kind === "trail" ? TRAIL_SHARE * span : 2 * span;
  }

  follow(agent) {
    this.followed = agent;
    this.last = null;
  }

  // Move the camera with the followed vehicle, as long as it is there.
  keepFollowed() {
    const i = this.followed;
    if (i < 0 || !this.bodies.geometry.attributes.size.array[i]) return (this.last = null);
    const here = new THREE.Vector3().fromArray(this.points, 3 * i);
    if (this.last) {
      const way = here.clone().sub(this.last);
      this.camera.position.add(way);
      this.controls.target.add(way);
    }
    this.last = here;
  }

  look(number) {
    const { camera, controls, middle, run } = this;
    const back = new THREE.Vector3(...this.run.viewpoint.views[number][1]).normalize();
    const right = new THREE.Vector3().crossVectors(camera.up, back).normalize();
    const up = new THREE.Vector3().crossVectors(back, right);
    const half = Math.tan((FIELD * Math.PI) / 360), at = new THREE.Vector3();
    let distance = 0; // from which all that is ever shown is in the field of view
    const enclose = (place) => {
      at.fromArray(place).sub(middle);
      const reach = Math.max(Math.abs(at.dot(right)) / camera.aspect, Math.abs(at.dot(up))) / half;
      if (reach > 0) distance = Math.max(distance, at.dot(back) + reach);
    };
    enclose(this.corner.toArray());
    for (const { position } of [run, run.targets]) {
      const every = 3 * Math.ceil(position.length / 1e5);
      for (let i = 0; i < position.length; i += every) enclose(position.subarray(i, i + 3));
    }
    controls.target.copy(middle);
    camera.position.copy(middle).addScaledVector(back, 1.12 * distance);
    controls.update();
  }

  // The number of the body at a place of the canvas, −1 where there is none.
  pick(x, y) {
    const { width, height } = this.canvas.getBoundingClientRect();
    const at = new THREE.Vector3(), { size } = this.bodies.geometry.attributes;
    let best = -1, least = 14;
    for (let i = 0; i < this.run.agents; i++) {
      if (!size.array[i]) continue;
      at.fromArray(this.points, 3 * i).project(this.camera);
      const away = Math.hypot((at.x + 1) * width / 2 - x, (1 - at.y) * height / 2 - y);
      if (away < least && at.z < 1) [best, least] = [i, away];
    }
    return best;
  }

  render() {
    const { canvas, renderer, camera } = this;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    const ratio = renderer.getPixelRatio();
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) {
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      this.isDirty = true;
    }
    if (!this.isDirty) return;
    this.isDirty = false;
    const unit = (height * ratio) / (2 * Math.tan((FIELD * Math.PI) / 360));
    for (const marks of [this.bodies, this.targets]) marks.material.uniforms.unit.value = unit;
    renderer.render(this.scene, camera);
    const at = new THREE.Vector3();
    for (const { span, place } of this.texts) {
      at.copy(place).project(camera);
      const x = (at.x + 1) * width / 2, y = (1 - at.y) * height / 2;
      span.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -50%)`;
      span.hidden = at.z > 1;
    }
  }
}
