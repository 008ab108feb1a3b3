// Plays a trace (docs/replay.md): what it shows was computed before, and is read, never simulated.
//
//   const player = await play(element, bytes);   // builds itself inside the element
//   player.pause(); player.frames; player.destroy();
//
// All texts of a trace come from elsewhere: they are set as text, never as markup. Colours are CSS custom properties (player.css).

const MAGIC = "zswtrace", VERSION = 1;
const TURN = 65536, STEPS = 65535, LEVELS = 254;
const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];
const SECONDS = 20, SLOWEST = 3, FASTEST = 500; // of a trial at speed 1; frames per second at least and at most
const TRAIL = 40; // frames
const JUMP = 5; // radii in a round: what moves further is not seen on the way
const PANEL_MS = 80; // between two changes of the numbers
const TALLEST = 0.68; // of the window, the picture
const FAINT = /\bout\b|outside|out of view|in the nest/; // kinds that take no part any more
const ACTS = /^(robot|opponent|cart|defender)\b(?!.*says)/; // kinds that are not known by what they are near
const KNOWN = [
  [/^opponents' home/, "--zp-home-2"], [/^opponents' flag/, "--zp-flag-2"],
  [/wall|blockade|track/, "--zp-wall"], [/exit|goal/, "--zp-exit"], [/nest|home/, "--zp-home"], [/flag's stand|^light$/, "--zp-flag"],
  [/^rod$/, "--zp-wall"], [/right/, "--zp-c3"], [/wrong|too much/, "--zp-c2"], [/too little/, "--zp-c1"],
];
const PALETTE = ["--zp-c1", "--zp-c2", "--zp-c3", "--zp-c4", "--zp-c5", "--zp-c6", "--zp-c7", "--zp-c8"];

/** Build a player.
 * @param {HTMLElement} element emptied, and filled with it
 * @param {Uint8Array|ArrayBuffer} bytes of a trace
 * @returns {Promise<{pause: function, destroy: function, frames: number}>} frames: pictures drawn so far
 */
export async function play(element, bytes) {
  const player = new Player(element, await decode(bytes));
  return {
    pause: () => player.pause(),
    destroy: () => player.destroy(),
    get frames() { return player.drawn; },
  };
}

// ---- bytes

async function decode(given) {
  const bytes = given instanceof Uint8Array ? given : new Uint8Array(given);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const text = new TextDecoder();
  if (bytes.length < 16 || text.decode(bytes.subarray(0, 8)) !== MAGIC) throw new Error("no trace");
  if (view.getUint32(8, true) !== VERSION) throw new Error(`a trace of version ${view.getUint32(8, true)}, expected ${VERSION}`);
  const end = 16 + view.getUint32(12, true);
  const header = JSON.parse(text.decode(bytes.subarray(16, end)));
  const stream = new Blob([bytes.subarray(end)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const packed = new Uint8Array(await new Response(stream).arrayBuffer());
  const tracks = {};
  let at = 0;
  for (const track of header.tracks) {
    const count = track.rows * track.columns;
    tracks[track.name] = { ...track, values: unpack(packed, at, track) };
    at += count * track.bytes;
  }
  if (at !== packed.length) throw new Error("a trace whose tables do not fit");
  return { ...header, tracks };
}

/** A table, row by row, from differences column by column. */
function unpack(packed, at, { rows, columns, bytes }) {
  const count = rows * columns, values = bytes === 2 ? new Uint16Array(count) : new Uint8Array(count);
  for (let column = 0; column < columns; column += 1) {
    let sum = 0;
    for (let row = 0; row < rows; row += 1) {
      const place = at + column * rows + row;
      sum += bytes === 2 ? packed[place] * 256 + packed[place + count] : packed[place];
      values[row * columns + column] = sum;
      sum = values[row * columns + column];
    }
  }
  return values;
}

// ---- the page

function made(tag, name, text) {
  const element = document.createElement(tag);
  if (name) element.className = name;
  if (text !== undefined) element.textContent = text;
  return element;
}

const SVG = "http://www.w3.org/2000/svg";
const ICONS = { // paths in a square of 16
  start: "M2 2h3v12H2zM14 2v12L5 8z", back: "M12 2v12L3 8z", play: "M4 2v12l10-6z", pause: "M3 2h4v12H3zM9 2h4v12H9z",
  ahead: "M3 2v12l8-6zM12 2h2v12h-2z",
};

function icon(name) {
  const picture = document.createElementNS(SVG, "svg"), path = document.createElementNS(SVG, "path");
  picture.setAttribute("viewBox", "0 0 16 16");
  picture.setAttribute("class", "zp-icon");
  picture.setAttribute("aria-hidden", "true");
  path.setAttribute("d", ICONS[name]);
  picture.append(path);
  return picture;
}

function button(label, picture, act) {
  const element = made("button", "zp-button");
  element.append(icon(picture));
  element.type = "button";
  element.setAttribute("aria-label", label);
  element.title = label;
  element.addEventListener("click", act);
  return element;
}

function option(select, value, text) {
  const element = made("option", "", text);
  element.value = value;
  select.append(element);
}

function shown(value) {
  if (value === null || Number.isNaN(value)) return "none";
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
}

class Player {
  constructor(element, trace) {
    this.element = element;
    this.trace = trace;
    this.bodies = trace.radii ? trace.radii.length : 0;
    this.last = this.bodies || trace.width ? trace.tracks.x.rows - 1 : Math.ceil(trace.rounds / trace.every);
    this.at = 0; // frames, and parts of them
    this.speed = 1;
    this.playing = false;
    this.chosen = -1;
    this.trails = false;
    this.rays = true;
    this.drawn = 0;
    this.panelAt = 0;
    this.still = window.matchMedia("(prefers-reduced-motion: reduce)");
    this.dark = window.matchMedia("(prefers-color-scheme: dark)");
    this.perSecond = Math.min(Math.max(this.last / SECONDS, SLOWEST), FASTEST);
    this.build();
    this.listen();
    this.restyle();
    if (trace.agents) this.choose(0);
    this.resize();
    if (!this.still.matches) this.start();
  }

  build() {
    const { trace } = this, root = made("section", "zp"), about = trace.about;
    root.setAttribute("aria-label", "replay of a trial");
    const name = [about.run ?? about.simulator];
    for (const key of ["generation", "candidate", "trial"]) if (about[key] !== undefined) name.push(`${key} ${about[key]}`);
    const title = made("h2", "zp-title", name.filter((part) => part !== undefined).join(" · "));
    const fitness = `fitness ${trace.fitness.map(shown).join(", ")}`;
    const metrics = Object.entries(trace.metrics).map(([key, value]) => `${key} ${shown(value)}`);
    root.append(title, made("p", "zp-result", [fitness, ...metrics].join(" · ")));
    for (const words of [trace.note, trace.error && `the trial failed: ${trace.error}`].filter(Boolean)) {
      const note = made("p", "zp-note", words);
      note.setAttribute("role", "alert");
      root.append(note);
    }
    this.stage = made("div", "zp-stage");
    this.canvas = made("canvas", "zp-canvas");
    this.canvas.setAttribute("role", "img");
    this.stage.append(this.canvas);
    const left = made("div", "zp-left"), row = made("div", "zp-row");
    if (trace.width) left.append(this.stage);
    else {
      const why = trace.no_picture ? ` (${trace.no_picture})` : "";
      left.append(made("p", "zp-dim", `This simulator draws no picture${why}: what the agents observe and set is shown alone.`));
    }
    left.append(this.bar(), this.legend());
    row.append(left, this.panel());
    root.append(row, this.facts());
    this.element.replaceChildren(root);
    this.root = root;
  }

  bar() {
    const bar = made("div", "zp-bar"), { trace } = this;
    bar.setAttribute("role", "group");
    bar.setAttribute("aria-label", "playing");
    this.slider = made("input", "zp-slider");
    Object.assign(this.slider, { type: "range", min: 0, max: this.last, step: 1, value: 0 });
    this.slider.setAttribute("aria-label", "round");
    this.slider.addEventListener("input", () => this.go(Number(this.slider.value)));
    this.playButton = button("play", "play", () => this.toggle());
    this.clock = made("span", "zp-clock");
    this.speeds = made("select", "zp-select");
    this.speeds.setAttribute("aria-label", "speed");
    for (const speed of SPEEDS) option(this.speeds, speed, `×${speed}`);
    this.speeds.value = 1;
    this.speeds.addEventListener("change", () => { this.speed = Number(this.speeds.value); });
    const first = made("div", "zp-line"), second = made("div", "zp-line");
    first.append(
      button("back to the start", "start", () => this.go(0)), button("a round back", "back", () => this.step(-1)), this.playButton,
      button("a round ahead", "ahead", () => this.step(1)), this.slider, this.clock,
    );
    second.append(this.speeds);
    if (trace.width) {
      this.trailsBox = this.checkbox(second, "trails", this.trails, (on) => { this.trails = on; });
      if (trace.rays.length) this.raysBox = this.checkbox(second, "sensors", this.rays, (on) => { this.rays = on; });
    }
    if (trace.agents) {
      this.agents = made("select", "zp-select");
      this.agents.setAttribute("aria-label", "agent");
      option(this.agents, -1, "no agent");
      for (let agent = 0; agent < trace.agents; agent += 1) option(this.agents, agent, `agent ${agent + 1}`);
      this.agents.addEventListener("change", () => this.choose(Number(this.agents.value)));
      second.append(this.agents);
    }
    bar.append(first, second);
    return bar;
  }

  checkbox(into, words, on, change) {
    const label = made("label", "zp-check"), box = made("input");
    box.type = "checkbox";
    box.checked = on;
    box.addEventListener("change", () => { change(box.checked); this.draw(); });
    label.append(box, document.createTextNode(words));
    into.append(label);
    return box;
  }

  legend() {
    const list = made("ul", "zp-legend"), { trace } = this;
    list.setAttribute("aria-label", "what is shown");
    this.swatches = [];
    (trace.kinds ?? []).forEach((kind, number) => {
      const item = made("li", "", ""), swatch = made("canvas", "zp-swatch");
      swatch.setAttribute("aria-hidden", "true");
      swatch.width = swatch.height = 32;
      item.append(swatch, document.createTextNode(kind));
      list.append(item);
      this.swatches.push([swatch, number, this.shapeOf(number)]);
    });
    return list;
  }

  /** The shape of the first body that is of a kind at some time; "place" and "line" of the others. */
  shapeOf(kind) {
    const { trace } = this;
    if (trace.places.some(([of]) => of === kind)) return "place";
    if (trace.lines.includes(kind)) return "line";
    const at = trace.tracks.kind.values.indexOf(kind);
    return trace.shapes[at % Math.max(1, this.bodies)] ?? "disc";
  }

  panel() {
    const { trace } = this, panel = made("div", "zp-panel");
    panel.setAttribute("aria-label", "numbers of the agent");
    panel.setAttribute("role", "region");
    this.panelTitle = made("h3", "zp-agent", "no agent chosen");
    this.strips = made("canvas", "zp-strips");
    this.strips.setAttribute("role", "img");
    this.strips.setAttribute("aria-label", "all numbers of the agent over the whole trial, a row each");
    panel.append(this.panelTitle);
    this.numbers = [];
    for (const [track, title, names] of [
      ["inputs", "observes", trace.sensors], ["hidden", "hidden neurons", trace.neurons], ["outputs", "sets", trace.actuators],
    ]) {
      if (!trace.tracks[track]) continue;
      panel.append(made("h4", "zp-what", title));
      const table = made("div", "zp-numbers");
      table.setAttribute("role", "group"); // it scrolls, and then has the focus
      table.setAttribute("aria-label", title);
      names.forEach((name, number) => {
        const value = made("span", "zp-value"), bar = made("span", "zp-amount"), rail = made("span", "zp-rail");
        const label = made("span", "zp-name", name);
        label.title = name;
        rail.setAttribute("aria-hidden", "true");
        rail.append(bar);
        table.append(label, rail, value);
        this.numbers.push({ track, number, value, bar, size: names.length });
      });
      panel.append(table);
    }
    panel.append(this.strips);
    panel.hidden = this.numbers.length === 0;
    return panel;
  }

  facts() {
    const { about } = this.trace, details = made("details", "zp-facts"), list = made("dl", "");
    details.append(made("summary", "", "where this is from, and keys"));
    for (const [key, value] of Object.entries(about)) {
      list.append(made("dt", "", key), made("dd", "", typeof value === "object" ? JSON.stringify(value) : String(value)));
    }
    const keys = [
      ["space", "play, pause"], ["← →", "a round back, ahead; with shift ten"], ["Home End", "start, end"], ["+ −", "faster, slower"],
      ["[ ]", "the agent before, the next one"], ["T, S", "trails, sensors"],
    ];
    for (const [key, what] of keys) list.append(made("dt", "", key), made("dd", "", what));
    details.append(list);
    return details;
  }

  // ---- what people do

  listen() {
    this.abort = new AbortController();
    const { signal } = this.abort;
    this.root.addEventListener("keydown", (event) => this.key(event), { signal });
    document.addEventListener("keydown", (event) => {
      if (event.target === document.body || event.target === document.documentElement) this.key(event);
    }, { signal });
    this.canvas.addEventListener("pointerdown", (event) => this.touch(event), { signal });
    for (const query of [this.dark, this.still]) query.addEventListener("change", () => this.restyle(), { signal });
    document.addEventListener("visibilitychange", () => { this.before = undefined; }, { signal });
    this.themes = new MutationObserver(() => this.restyle());
    this.themes.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    this.sizes = new ResizeObserver(() => requestAnimationFrame(() => this.root.isConnected && this.resize()));
    this.sizes.observe(this.root);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select")) return;
    const on = event.target.closest("button, summary, input"), slider = event.target === this.slider;
    const acts = {
      " ": () => !(on && !slider) && this.toggle(),
      ArrowLeft: () => !slider && this.step(event.shiftKey ? -10 : -1),
      ArrowRight: () => !slider && this.step(event.shiftKey ? 10 : 1),
      Home: () => this.go(0),
      End: () => this.go(this.last),
      "+": () => this.faster(1),
      "=": () => this.faster(1),
      "-": () => this.faster(-1),
      "[": () => this.choose(this.chosen - 1),
      "]": () => this.choose(this.chosen + 1),
      t: () => this.trailsBox?.click(),
      s: () => this.raysBox?.click(),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (act && act() !== false) event.preventDefault();
  }

  touch(event) {
    const box = this.canvas.getBoundingClientRect(), { trace, view } = this;
    const x = (event.clientX - box.left) / view.scale + view.left, y = (event.clientY - box.top) / view.scale + view.top;
    const reach = 24 / view.scale;
    let best = -1, least = Infinity;
    for (let agent = 0; agent < Math.min(trace.agents, this.bodies); agent += 1) {
      const [bx, by] = this.place(agent), away = Math.hypot(bx - x, by - y) - trace.radii[agent];
      if (away < least) [best, least] = [agent, away];
    }
    this.choose(least < reach ? best : -1);
  }

  toggle() { if (this.playing) this.pause(); else this.start(); }

  start() {
    if (this.at >= this.last) this.at = 0;
    this.playing = true;
    this.before = undefined;
    this.said();
    this.request ??= requestAnimationFrame((now) => this.tick(now));
  }

  pause() {
    this.playing = false;
    this.said();
    this.draw();
  }

  said() {
    this.playButton.title = this.playing ? "pause" : "play";
    this.playButton.replaceChildren(icon(this.playButton.title));
    this.playButton.setAttribute("aria-label", this.playButton.title);
  }

  step(by) {
    this.go(Math.min(Math.max((by < 0 ? Math.ceil(this.at) : Math.floor(this.at)) + by, 0), this.last));
  }

  go(at) {
    this.at = at;
    this.playing = false;
    this.said();
    this.draw();
  }

  faster(by) {
    const at = Math.min(Math.max(SPEEDS.indexOf(this.speed) + by, 0), SPEEDS.length - 1);
    this.speed = SPEEDS[at];
    this.speeds.value = this.speed;
  }

  choose(agent) {
    if (!this.trace.agents || agent >= this.trace.agents || agent < -1) return;
    this.chosen = agent;
    this.agents.value = agent;
    this.panelTitle.textContent = agent < 0 ? "no agent chosen" : `agent ${agent + 1}`;
    this.drawStrips();
    this.draw();
  }

  destroy() {
    this.playing = false;
    if (this.request) cancelAnimationFrame(this.request);
    this.abort.abort();
    this.themes.disconnect();
    this.sizes.disconnect();
    this.element.replaceChildren();
  }

  // ---- pictures

  tick(now) {
    this.request = undefined;
    if (!this.playing) return;
    const passed = this.before === undefined ? 0 : Math.min((now - this.before) / 1000, 0.25);
    this.before = now;
    this.at += passed * this.perSecond * this.speed;
    if (this.at >= this.last) {
      this.at = this.last;
      this.playing = false;
      this.said();
    }
    this.draw();
    if (this.playing) this.request = requestAnimationFrame((next) => this.tick(next));
  }

  restyle() {
    const style = getComputedStyle(this.root), colour = (name) => style.getPropertyValue(name).trim() || "#888";
    this.colours = { fg: colour("--zp-fg"), field: colour("--zp-field"), edge: colour("--zp-line"), accent: colour("--zp-accent") };
    let next = 0;
    this.kindColours = (this.trace.kinds ?? []).map((kind) => {
      const known = KNOWN.find(([pattern]) => !ACTS.test(kind) && pattern.test(kind));
      return colour(known ? known[1] : PALETTE[next++ % PALETTE.length]);
    });
    for (const [canvas, kind, shape] of this.swatches) this.drawSwatch(canvas, kind, shape);
    this.background = undefined;
    this.drawStrips();
    this.draw();
  }

  resize() {
    const { trace } = this;
    this.drawStrips();
    if (!trace.width) {
      this.draw();
      return;
    }
    const { x, y } = trace.tracks;
    const left = Math.min(0, x.low[0]), top = Math.min(0, y.low[0]);
    const wide = Math.max(trace.width, x.high[0]) - left, high = Math.max(trace.height, y.high[0]) - top;
    const room = this.stage.clientWidth || 400;
    const scale = Math.min(room / wide, (Math.max(window.innerHeight, 400) * TALLEST) / high);
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.view = { left, top, scale, ratio, wide: wide * scale, high: high * scale };
    this.canvas.width = Math.max(1, Math.round(this.view.wide * ratio));
    this.canvas.height = Math.max(1, Math.round(this.view.high * ratio));
    this.canvas.style.width = `${this.view.wide}px`;
    this.canvas.style.height = `${this.view.high}px`;
    this.background = undefined;
    this.draw();
  }

  /** Where a column of the places' tables is now: between two frames, unless it jumped or nobody wants motion. */
  place(column, radius = this.trace.radii[column]) {
    const { x, y } = this.trace.tracks, frame = Math.floor(this.at), part = this.still.matches ? 0 : this.at - frame;
    const from = frame * x.columns + column;
    const x0 = this.real(x, from), y0 = this.real(y, from);
    if (part === 0 || frame >= this.last) return [x0, y0];
    const x1 = this.real(x, from + x.columns), y1 = this.real(y, from + y.columns);
    if (radius !== undefined && Math.hypot(x1 - x0, y1 - y0) > this.jump(radius)) return part < 0.5 ? [x0, y0] : [x1, y1];
    return [x0 + (x1 - x0) * part, y0 + (y1 - y0) * part];
  }

  jump(radius) {
    return JUMP * radius * this.trace.every;
  }

  real(track, at) {
    return track.low[0] + (track.values[at] / STEPS) * (track.high[0] - track.low[0]);
  }

  heading(body) {
    const { heading } = this.trace.tracks, frame = Math.floor(this.at), part = this.still.matches ? 0 : this.at - frame;
    const from = heading.values[frame * heading.columns + body];
    let by = frame < this.last ? heading.values[(frame + 1) * heading.columns + body] - from : 0;
    if (by > TURN / 2) by -= TURN;
    if (by < -TURN / 2) by += TURN;
    return ((from + by * part) / TURN) * 2 * Math.PI;
  }

  kind(body) {
    const { kind } = this.trace.tracks;
    return kind.values[Math.floor(this.at) * kind.columns + body];
  }

  draw() {
    if (!this.root) return;
    this.drawn += 1;
    const { trace } = this, frame = Math.floor(this.at);
    const round = Math.min(frame * trace.every, trace.rounds);
    const words = `${round} / ${trace.rounds}`;
    if (this.clock.textContent !== words) {
      this.clock.textContent = words;
      this.slider.value = frame;
      this.slider.setAttribute("aria-valuetext", `round ${round} of ${trace.rounds}`);
    }
    if (trace.width && this.view) this.drawField();
    const now = performance.now();
    if (!this.playing || now - this.panelAt > PANEL_MS) {
      this.panelAt = now;
      this.drawNumbers();
      if (trace.width) this.canvas.setAttribute("aria-label", this.words());
    }
  }

  drawField() {
    const { trace, view, canvas } = this, context = canvas.getContext("2d");
    this.background ??= this.drawBackground();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.background, 0, 0);
    this.toField(context);
    if (this.trails) this.drawTrails(context);
    if (this.chosen >= 0 && this.chosen < this.bodies) {
      this.drawWay(context, this.chosen, 0, 1.5);
      if (this.rays) this.drawRays(context);
    }
    this.drawLines(context);
    const groups = new Map();
    for (let body = this.bodies - 1; body >= 0; body -= 1) {
      const kind = this.kind(body), key = kind * 8 + (trace.headed[body] ? 1 : 0);
      if (!groups.has(key)) groups.set(key, []);
      groups.get(key).push(body);
    }
    for (const [key, bodies] of groups) this.drawBodies(context, Math.floor(key / 8), bodies);
    if (this.chosen >= 0 && this.chosen < this.bodies) {
      const [x, y] = this.place(this.chosen);
      context.beginPath();
      context.arc(x, y, trace.radii[this.chosen] + 4 / view.scale, 0, 2 * Math.PI);
      context.lineWidth = 2.5 / view.scale;
      context.strokeStyle = this.colours.fg;
      context.stroke();
    }
    this.drawLabels(context);
  }

  /** The picture, for those who do not see it. */
  words() {
    const { trace } = this, counts = new Map();
    for (let body = 0; body < this.bodies; body += 1) counts.set(this.kind(body), (counts.get(this.kind(body)) ?? 0) + 1);
    const parts = [...counts].map(([kind, count]) => `${trace.kinds[kind]}: ${count}`);
    return `picture of the trial: ${parts.join(", ")}`;
  }

  toField(context) {
    const { scale, ratio, left, top } = this.view;
    context.setTransform(scale * ratio, 0, 0, scale * ratio, -left * scale * ratio, -top * scale * ratio);
  }

  drawBackground() {
    const { trace, view } = this, layer = document.createElement("canvas");
    layer.width = this.canvas.width;
    layer.height = this.canvas.height;
    const context = layer.getContext("2d");
    context.fillStyle = this.colours.field;
    context.fillRect(0, 0, layer.width, layer.height);
    this.toField(context);
    for (const [kind, x, y, width, height] of trace.places) {
      context.fillStyle = this.kindColours[kind];
      context.fillRect(x, y, Math.max(width, 1 / view.scale), Math.max(height, 1 / view.scale));
    }
    context.strokeStyle = this.colours.edge;
    context.lineWidth = 1 / view.scale;
    context.strokeRect(0, 0, trace.width, trace.height);
    return layer;
  }

  drawTrails(context) {
    const begin = Math.max(0, Math.floor(this.at) - TRAIL);
    for (let agent = 0; agent < Math.min(this.trace.agents, this.bodies); agent += 1) this.drawWay(context, agent, begin, 1);
  }

  /** The way of a body since a frame. */
  drawWay(context, body, begin, width) {
    const { x, y } = this.trace.tracks, { view, trace } = this, end = Math.floor(this.at);
    const every = Math.max(1, Math.floor((end - begin) / 600)), jump = this.jump(trace.radii[body]) * every;
    context.beginPath();
    let px, py;
    for (let frame = begin; frame <= end; frame += every) {
      const at = frame * x.columns + body, nx = this.real(x, at), ny = this.real(y, at);
      if (px === undefined || Math.hypot(nx - px, ny - py) > jump) context.moveTo(nx, ny);
      else context.lineTo(nx, ny);
      [px, py] = [nx, ny];
    }
    if (px !== undefined) {
      const [nx, ny] = this.place(body);
      if (Math.hypot(nx - px, ny - py) <= jump) context.lineTo(nx, ny);
    }
    context.globalAlpha = 0.45;
    context.strokeStyle = this.kindColours[this.kind(body)];
    context.lineWidth = (width * 1.3) / view.scale;
    context.lineJoin = "round";
    context.stroke();
    context.globalAlpha = 1;
  }

  drawRays(context) {
    const { trace, view } = this, numbers = this.numbersAt("inputs");
    if (!numbers) return;
    const [x, y] = this.place(this.chosen), towards = trace.headed[this.chosen] ? this.heading(this.chosen) : 0;
    for (const [sensor, angle, at0, at1, spread, aside] of trace.rays) {
      const value = numbers(sensor);
      if (value === null) continue;
      const length = Math.max(0, at0 + value * (at1 - at0)), to = towards + angle;
      const fromX = x - Math.sin(towards) * aside, fromY = y + Math.cos(towards) * aside;
      context.beginPath();
      context.moveTo(fromX, fromY);
      if (spread > 0) {
        context.arc(fromX, fromY, length, to - spread / 2, to + spread / 2);
        context.closePath();
        context.fillStyle = this.colours.accent;
        context.globalAlpha = 0.16;
        context.fill();
      } else {
        context.lineTo(fromX + Math.cos(to) * length, fromY + Math.sin(to) * length);
      }
      context.globalAlpha = 0.8;
      context.strokeStyle = this.colours.accent;
      context.lineWidth = 1.2 / view.scale;
      context.stroke();
      context.globalAlpha = 1;
    }
  }

  drawLines(context) {
    const { trace } = this;
    trace.lines.forEach((kind, number) => {
      const column = this.bodies + 2 * number, from = this.place(column, undefined), to = this.place(column + 1, undefined);
      context.beginPath();
      context.moveTo(...from);
      context.lineTo(...to);
      context.strokeStyle = this.kindColours[kind];
      context.lineWidth = 3 / this.view.scale;
      context.stroke();
    });
  }

  drawBodies(context, kind, bodies) {
    const { trace, view } = this, name = trace.kinds[kind];
    context.globalAlpha = FAINT.test(name) ? 0.45 : 1;
    context.fillStyle = this.kindColours[kind];
    context.strokeStyle = this.colours.field;
    context.lineWidth = 1 / view.scale;
    context.beginPath();
    for (const body of bodies) {
      const [x, y] = this.place(body), turned = trace.headed[body] ? this.heading(body) : 0;
      outline(context, trace.shapes[body], x, y, Math.max(trace.radii[body], 1.6 / view.scale), turned);
    }
    context.fill();
    context.stroke();
    if (trace.headed[bodies[0]] && trace.shapes[bodies[0]] === "disc") {
      context.beginPath();
      for (const body of bodies) {
        const [x, y] = this.place(body), to = this.heading(body), radius = trace.radii[body];
        context.moveTo(x + Math.cos(to) * radius * 0.15, y + Math.sin(to) * radius * 0.15);
        context.lineTo(x + Math.cos(to) * radius * 0.95, y + Math.sin(to) * radius * 0.95);
      }
      context.lineWidth = Math.max(trace.radii[bodies[0]] * 0.28, 1 / view.scale);
      context.strokeStyle = this.colours.field;
      context.stroke();
    }
    if (/ with /.test(name)) {
      context.beginPath();
      for (const body of bodies) {
        const [x, y] = this.place(body), radius = trace.radii[body];
        context.rect(x - radius * 0.3, y - radius * 0.3, radius * 0.6, radius * 0.6);
      }
      context.fillStyle = this.colours.field;
      context.fill();
    }
    context.globalAlpha = 1;
  }

  drawLabels(context) {
    let words = [];
    for (const [frame, labels] of this.trace.labels) {
      if (frame > Math.floor(this.at)) break;
      words = labels;
    }
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineJoin = "round";
    const { ratio, scale, left, top } = this.view;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    for (const [text, x, y, size] of words) {
      context.font = `${Math.max(size * scale, 11)}px system-ui, sans-serif`;
      context.strokeStyle = this.colours.field;
      context.lineWidth = 3;
      context.fillStyle = this.colours.fg;
      context.strokeText(text, (x - left) * scale, (y - top) * scale);
      context.fillText(text, (x - left) * scale, (y - top) * scale);
    }
  }

  drawSwatch(canvas, kind, shape) {
    const context = canvas.getContext("2d"), name = this.trace.kinds[kind];
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.globalAlpha = FAINT.test(name) && shape !== "place" ? 0.45 : 1;
    context.fillStyle = context.strokeStyle = this.kindColours[kind];
    context.beginPath();
    if (shape === "place") context.rect(1, 5, 30, 22);
    else if (shape === "line") context.rect(2, 13, 28, 6);
    else outline(context, shape, 16, 16, shape === "square" ? 11 : 13, 0);
    context.fill();
    if (/ with /.test(name)) {
      context.fillStyle = this.colours.field;
      context.fillRect(12, 12, 8, 8);
    }
    context.globalAlpha = 1;
  }

  // ---- numbers

  /** A function that gives the chosen agent's numbers of a track now, null for none; null where there is nothing. */
  numbersAt(name, frame = Math.floor(this.at)) {
    const track = this.trace.tracks[name];
    if (!track || this.chosen < 0) return null;
    const row = Math.min(Math.floor(frame / this.trace.numbers_every), track.rows - 1), size = track.low.length;
    const at = row * track.columns + this.chosen * size;
    return (number) => {
      const level = track.values[at + number];
      if (level === 0) return null;
      return track.low[number] + ((level - 1) / LEVELS) * (track.high[number] - track.low[number]);
    };
  }

  drawNumbers() {
    const of = new Map();
    for (const { track, number, value, bar } of this.numbers) {
      if (!of.has(track)) of.set(track, this.numbersAt(track));
      const read = of.get(track), now = read ? read(number) : null, { low, high } = this.trace.tracks[track];
      value.textContent = now === null ? "–" : now.toFixed(Math.abs(now) >= 100 ? 0 : 2);
      const least = Math.min(low[number], 0), most = Math.max(high[number], 0, least + 1e-9), span = most - least;
      const from = now === null ? 0 : (Math.min(now, 0) - least) / span, size = now === null ? 0 : Math.abs(now) / span;
      bar.style.left = `${100 * from}%`;
      bar.style.width = `${100 * Math.min(size, 1)}%`;
    }
    if (this.stripsImage) {
      const context = this.strips.getContext("2d"), { width, height } = this.strips;
      context.drawImage(this.stripsImage, 0, 0);
      context.fillStyle = this.colours.fg;
      context.fillRect((this.at / Math.max(1, this.last)) * (width - 2), 0, 2, height);
    }
  }

  /** All numbers of the chosen agent over the trial, dark for low and bright for high ones; drawn once. */
  drawStrips() {
    this.stripsImage = undefined;
    this.strips.hidden = this.chosen < 0 || !this.numbers.length;
    if (this.strips.hidden || !this.colours) return;
    const high = 6, width = Math.max(60, Math.round(this.strips.clientWidth || 240));
    this.strips.width = width;
    this.strips.height = this.numbers.length * high;
    const image = document.createElement("canvas");
    image.width = width;
    image.height = this.strips.height;
    const context = image.getContext("2d");
    context.fillStyle = this.colours.field;
    context.fillRect(0, 0, width, image.height);
    context.fillStyle = this.colours.accent;
    const columns = Math.min(width, this.last), wide = width / Math.max(1, columns);
    for (let column = 0; column < columns; column += 1) {
      const frame = Math.floor((column / columns) * this.last), of = new Map();
      this.numbers.forEach(({ track, number }, row) => {
        if (!of.has(track)) of.set(track, this.numbersAt(track, frame));
        const value = of.get(track)?.(number), { low, high: top } = this.trace.tracks[track];
        if (value === null || value === undefined) return;
        context.globalAlpha = 0.05 + 0.95 * ((value - low[number]) / (top[number] - low[number] || 1));
        context.fillRect(column * wide, row * high, wide + 0.5, high - 1);
      });
    }
    this.stripsImage = image;
  }
}

/** Add a shape to a path. */
function outline(context, shape, x, y, radius, turned) {
  const corners = { square: [1, 3, 5, 7], diamond: [0, 2, 4, 6], triangle: null }[shape];
  if (corners === undefined) {
    context.moveTo(x + radius, y);
    context.arc(x, y, radius, 0, 2 * Math.PI);
    return;
  }
  const angles = corners ? corners.map((eighth) => (eighth * Math.PI) / 4) : [-0.5, 1 / 6, 5 / 6].map((half) => half * Math.PI);
  const reach = shape === "square" ? radius * Math.SQRT2 : shape === "triangle" ? radius * 1.2 : radius * 1.1;
  angles.forEach((angle, number) => {
    const to = [x + Math.cos(angle + turned) * reach, y + Math.sin(angle + turned) * reach];
    if (number) context.lineTo(...to);
    else context.moveTo(...to);
  });
  context.closePath();
}
