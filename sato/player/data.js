// Data of the run: arrays of 16-bit integers, deflated, as sato/player/encode.py writes them.
const MISSING = 65535;
const ABSENT = 0, LOST = 2; // status of a vehicle

async function readRun(text) {
  const letters = atob(text), packed = new Uint8Array(letters.length);
  for (let i = 0; i < packed.length; i++) packed[i] = letters.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(bytes.buffer).getUint32(0, true);
  const run = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  const body = bytes.subarray(4 + length);
  const decode = (about) => decodeArray(body, about);
  run.error = run.position.error; // [m]
  for (const name of ["position", "velocity", "status"]) run[name] = decode(run[name]);
  const { targets, links } = run;
  targets.count = targets.position.shape[1];
  for (const name of ["position", "held"]) targets[name] = decode(targets[name]);
  if (links.radius === null) links.pairs = decode(links.pairs);
  for (const series of run.series) series.values = decode(series.values);
  for (const coloring of run.colorings) {
    const about = coloring.values; // decoded when it is first asked for
    Object.defineProperty(coloring, "values", { get: () => (about.values ??= decode(about)) });
  }
  run.agents = run.diameter.length;
  run.start = run.time[0];
  run.end = run.time[run.time.length - 1];
  return run;
}

// Sum differences of differences over the first axis, and scale.
function decodeArray(body, { start, shape, scale, first }) {
  const rows = shape[0], size = shape.reduce((a, b) => a * b, 1), columns = size / rows || 0;
  const found = new Float32Array(size);
  for (let c = 0, i = start; c < columns; c++) {
    let step = 0, code = 0;
    for (let r = 0; r < rows; r++, i++) {
      step = (step + body[i] + 256 * body[i + size]) & 65535;
      code = (code + step) & 65535;
      found[r * columns + c] = code === MISSING ? NaN : scale * (first + code);
    }
  }
  return found;
}

// The last index whose value is not above the given one; 0 where there is none.
function lastUntil(sorted, value) {
  let low = 0, high = sorted.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (sorted[middle] <= value) low = middle;
    else high = middle;
  }
  return low;
}

// Write the positions at a time: cubic pieces by position and velocity at their ends.
function interpolate(run, time, found) {
  const k = lastUntil(run.time, time), next = Math.min(k + 1, run.time.length - 1);
  const h = run.time[next] - run.time[k] || 1;
  const s = Math.min(Math.max((time - run.time[k]) / h, 0), 1), r = 1 - s;
  const a = r * r * (1 + 2 * s), b = s * s * (1 + 2 * r), c = h * s * r * r, d = -h * s * s * r;
  const n = 3 * run.agents, { position, velocity } = run;
  for (let i = 0, p = k * n, q = next * n; i < n; i++, p++, q++) {
    found[i] = a * position[p] + b * position[q] + c * velocity[p] + d * velocity[q];
  }
  return k;
}

// Write pairs of live vehicles within the radius into a list; only neighboring cells are searched.
function findPairs(points, isAlive, radius, found) {
  const cells = new Map(), n = isAlive.length, wide = 2048;
  const cell = (i, axis) => Math.floor(points[3 * i + axis] / radius) + wide / 2;
  const key = (x, y, z) => (x * wide + y) * wide + z;
  found.length = 0;
  for (let i = 0; i < n; i++) {
    if (!isAlive[i]) continue;
    const x = cell(i, 0), y = cell(i, 1), z = cell(i, 2);
    for (let a = x - 1; a <= x + 1; a++)
      for (let b = y - 1; b <= y + 1; b++)
        for (let c = z - 1; c <= z + 1; c++) {
          for (const j of cells.get(key(a, b, c)) || []) {
            const u = points[3 * i] - points[3 * j], v = points[3 * i + 1] - points[3 * j + 1];
            const w = points[3 * i + 2] - points[3 * j + 2];
            if (u * u + v * v + w * w <= radius * radius) found.push(j, i);
          }
        }
    const own = key(x, y, z);
    if (cells.has(own)) cells.get(own).push(i);
    else cells.set(own, [i]);
  }
}
