// The picture of a trial: what is where at a time, and drawing it. Nothing is simulated.

const TURN = 65536, STEPS = 65535, LEVELS = 254; // of headings, coordinates and numbers
const TRAIL = 40; // frames
const JUMP = 5; // radii per round: a larger move is not interpolated
const TALLEST = 0.68; // height of the picture, as a share of the window
const HOLLOW = /\bout\b|outside|out of view|in the nest/; // kinds that take no part any more
const LOADED = / with /; // kinds that carry something
const GROUND = /^floor-/; // colours of what everything else stands on
// Of shapes: the first corner in half turns, the number of corners, and their distance in radii.
const CORNERS = { square: [0.25, 4, Math.SQRT2], diamond: [0, 4, 1.1], triangle: [-0.5, 3, 1.2] };

export class Picture {
  constructor(trace) {
    this.trace = trace;
    this.bodies = trace.radii ? trace.radii.length : 0;
    this.last = this.bodies || trace.width ? trace.tracks.x.rows - 1
      : Math.ceil(trace.rounds / trace.every);
    this.at = 0; // frames, and parts of them
    this.chosen = -1;
    this.trails = false;
    this.rays = true;
    this.still = window.matchMedia("(prefers-reduced-motion: reduce)");
  }

  /** Read the colours of the page, which a canvas cannot resolve by their names. */
  readColours(root) {
    const colour = (name) => {
      root.style.color = `var(${name})`;
      return getComputedStyle(root).color;
    };
    this.colours = { fg: colour("--zp-fg"), field: colour("--zp-field"), edge: colour("--zp-line"),
      accent: colour("--zp-accent") };
    this.low = colour("--zp-c1");
    this.high = colour("--zp-c2");
    this.kindColours = (this.trace.colours ?? []).map((name) => colour(`--zp-${name}`));
    root.style.color = "";
    this.background = undefined;
  }

  /** Fit the canvas into a width. */
  fit(room) {
    const { trace, canvas } = this;
    this.extents ??= [this.extent("x", trace.width), this.extent("y", trace.height)];
    const [[left, right], [top, bottom]] = this.extents;
    const wide = right - left, high = bottom - top;
    const scale = Math.min(room / wide, (Math.max(window.innerHeight, 400) * TALLEST) / high);
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.view = { left, top, scale, ratio };
    canvas.width = Math.max(1, Math.round(wide * scale * ratio));
    canvas.height = Math.max(1, Math.round(high * scale * ratio));
    canvas.style.width = `${wide * scale}px`;
    canvas.style.height = `${high * scale}px`;
    this.background = undefined;
  }

  /** Return from where to where something is drawn: the field, and what reaches over its edge. */
  extent(axis, size) {
    const track = this.trace.tracks[axis], { radii } = this.trace;
    const edge = size / 200; // of the lines
    let low = -edge, high = size + edge;
    for (let at = 0; at < track.values.length; at += 1) {
      const middle = this.real(track, at), body = at % track.columns,
        reach = (radii[body] ?? 0) + edge;
      low = Math.min(low, middle - reach);
      high = Math.max(high, middle + reach);
    }
    return [low, high];
  }

  /** Return the place of a body or an end of a line; it is not interpolated where it jumped. */
  place(column, radius = this.trace.radii[column]) {
    const { x, y } = this.trace.tracks, { frame, part } = this.now();
    const from = frame * x.columns + column;
    const x0 = this.real(x, from), y0 = this.real(y, from);
    if (part === 0 || frame >= this.last) return [x0, y0];
    const x1 = this.real(x, from + x.columns), y1 = this.real(y, from + y.columns);
    if (radius !== undefined && Math.hypot(x1 - x0, y1 - y0) > this.jump(radius)) return part < 0.5
      ? [x0, y0] : [x1, y1];
    return [x0 + (x1 - x0) * part, y0 + (y1 - y0) * part];
  }

  /** Return the frame, and how far the next one has come. */
  now() {
    const frame = Math.floor(this.at);
    return { frame, part: this.still.matches ? 0 : this.at - frame };
  }

  jump(radius) {
    return JUMP * radius * this.trace.every;
  }

  real(track, at) {
    return track.low[0] + (track.values[at] / STEPS) * (track.high[0] - track.low[0]);
  }

  heading(body) {
    const { heading } = this.trace.tracks, { frame, part } = this.now();
    const from = heading.values[frame * heading.columns + body];
    const to = frame < this.last ? heading.values[(frame + 1) * heading.columns + body] : from;
    const by = ((to - from + 1.5 * TURN) % TURN) - TURN / 2; // the short way
    return ((from + by * part) / TURN) * 2 * Math.PI;
  }

  kind(body) {
    const { kind } = this.trace.tracks;
    return kind.values[Math.floor(this.at) * kind.columns + body];
  }

  /** Return a function that reads a number of the chosen agent, null for none; or null. */
  numbersAt(name, frame = Math.floor(this.at)) {
    const track = this.trace.tracks[name];
    if (!track || this.chosen < 0) return null;
    const row = Math.min(Math.floor(frame / this.trace.numbers_every), track.rows - 1),
      size = track.low.length;
    const at = row * track.columns + this.chosen * size;
    return (number) => {
      const level = track.values[at + number];
      if (level === 0) return null;
      return track.low[number] + ((level - 1) / LEVELS) * (track.high[number] - track.low[number]);
    };
  }

  /** Describe the picture, for screen readers. */
  description() {
    const counts = {};
    for (let body = 0; body < this.bodies; body += 1) {
      const kind = this.trace.kinds[this.kind(body)];
      counts[kind] = (counts[kind] ?? 0) + 1;
    }
    const parts = Object.entries(counts).map(([kind, count]) => `${kind}: ${count}`);
    return `picture of the trial: ${parts.join(", ")}`;
  }

  toField(context) {
    const { scale, ratio, left, top } = this.view;
    context.setTransform(scale * ratio, 0, 0, scale * ratio, -left * scale * ratio,
      -top * scale * ratio);
  }

  drawField() {
    const { trace, view, canvas } = this, context = canvas.getContext("2d");
    this.background ??= this.drawBackground();
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.background, 0, 0);
    this.toField(context);
    const ground = [], standing = [];
    for (const group of this.groups()) (this.isGround(group.kind) ? ground : standing).push(group);
    for (const { kind, bodies } of ground) this.drawBodies(context, kind, bodies);
    const trails = this.trails ? Math.min(trace.agents, this.bodies) : 0,
      chosen = this.chosen >= 0 && this.chosen < this.bodies;
    for (let agent = 0; agent < trails; agent += 1) {
      this.drawPath(context, agent, Math.max(0, Math.floor(this.at) - TRAIL), 1.3);
    }
    if (chosen) {
      this.drawPath(context, this.chosen, 0, 2);
      if (this.rays) this.drawRays(context);
    }
    this.drawLines(context);
    for (const { kind, bodies } of standing) this.drawBodies(context, kind, bodies);
    if (chosen) {
      const [x, y] = this.place(this.chosen);
      context.beginPath();
      context.arc(x, y, trace.radii[this.chosen] + 4 / view.scale, 0, 2 * Math.PI);
      // Visible on each floor.
      for (const [width, colour] of [[5, this.colours.field], [2.5, this.colours.fg]]) {
        context.lineWidth = width / view.scale;
        context.strokeStyle = colour;
        context.stroke();
      }
    }
    this.drawLabels(context);
  }

  /** Return bodies by their kinds, first the last ones: agents are drawn over others. */
  groups() {
    const groups = new Map();
    for (let body = this.bodies - 1; body >= 0; body -= 1) {
      const kind = this.kind(body), key = 2 * kind + this.trace.headed[body];
      if (!groups.has(key)) groups.set(key, { kind, bodies: [] });
      groups.get(key).bodies.push(body);
    }
    return groups.values();
  }

  isGround(kind) {
    return GROUND.test(this.trace.colours[kind]);
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

  /** Draw the path of a body since a frame. */
  drawPath(context, body, begin, width) {
    const { x, y } = this.trace.tracks, { view, trace } = this, end = Math.floor(this.at);
    const every = Math.max(1, Math.floor((end - begin) / 600)),
      jump = this.jump(trace.radii[body]) * every;
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
    context.lineWidth = width / view.scale;
    context.lineJoin = "round";
    context.stroke();
    context.globalAlpha = 1;
  }

  drawRays(context) {
    const { trace, view } = this, numbers = this.numbersAt("inputs");
    if (!numbers) return;
    const [x, y] = this.place(this.chosen),
      towards = trace.headed[this.chosen] ? this.heading(this.chosen) : 0;
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
      const column = this.bodies + 2 * number, from = this.place(column),
        to = this.place(column + 1);
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
    const hollow = HOLLOW.test(name), line = Math.max(0.3 * trace.radii[bodies[0]], 1 / view.scale);
    context.beginPath();
    for (const body of bodies) {
      const [x, y] = this.place(body), turned = trace.headed[body] ? this.heading(body) : 0,
        radius = Math.max(trace.radii[body], 1.6 / view.scale);
      outline(context, trace.shapes[body], x, y, hollow ? radius - line / 2 : radius, turned);
    }
    this.paint(context, kind, hollow, hollow ? line : 1 / view.scale);
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
    if (LOADED.test(name)) {
      context.beginPath();
      for (const body of bodies) {
        const [x, y] = this.place(body), radius = trace.radii[body];
        context.rect(x - radius * 0.3, y - radius * 0.3, radius * 0.6, radius * 0.6);
      }
      context.fillStyle = this.colours.field;
      context.fill();
    }
  }

  /** Fill a path, or only draw it where a kind is hollow. */
  paint(context, kind, hollow, width) {
    const colour = this.kindColours[kind], { field } = this.colours;
    context.fillStyle = hollow ? field : colour;
    context.strokeStyle = hollow ? colour : field;
    context.lineWidth = width;
    context.fill();
    if (hollow || !this.isGround(kind)) context.stroke();
  }

  drawLabels(context) {
    const [, words] = this.trace.labels.findLast(([frame]) => frame <= this.at) ?? [0, []];
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.lineJoin = "round";
    const { ratio, scale, left, top } = this.view;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.strokeStyle = this.colours.field;
    context.fillStyle = this.colours.fg;
    context.lineWidth = 3;
    for (const [text, x, y, size] of words) {
      context.font = `${Math.max(size * scale, 11)}px system-ui, sans-serif`;
      context.strokeText(text, (x - left) * scale, (y - top) * scale);
      context.fillText(text, (x - left) * scale, (y - top) * scale);
    }
  }

  /** Return the shape of the first body of a kind, "place" or "line". */
  shapeOf(kind) {
    const { lines, places, shapes, tracks } = this.trace;
    if (places.some(([of]) => of === kind)) return "place";
    return lines.includes(kind) ? "line" : shapes[tracks.kind.values.indexOf(kind) % this.bodies];
  }

  /** Draw the sample of a kind in the legend. */
  drawSwatch(canvas, kind) {
    const context = canvas.getContext("2d"), name = this.trace.kinds[kind],
      shape = this.shapeOf(kind);
    const body = shape !== "place" && shape !== "line";
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.beginPath();
    if (shape === "place") context.rect(1, 5, 30, 22);
    else if (shape === "line") context.rect(2, 13, 28, 6);
    else outline(context, shape, 16, 16, shape === "square" ? 11 : 13, 0);
    this.paint(context, kind, body && HOLLOW.test(name), 4);
    if (this.isGround(kind)) { // white and black are also colours of pages
      context.strokeStyle = this.colours.edge;
      context.lineWidth = 2;
      context.stroke();
    }
    if (body && LOADED.test(name)) {
      context.fillStyle = this.colours.field;
      context.fillRect(12, 12, 8, 8);
    }
  }
}

/** Add a shape to a path. */
function outline(context, shape, x, y, radius, turned) {
  if (!(shape in CORNERS)) {
    context.moveTo(x + radius, y);
    context.arc(x, y, radius, 0, 2 * Math.PI);
    return;
  }
  const [first, count, reach] = CORNERS[shape];
  for (let corner = 0; corner < count; corner += 1) {
    const angle = Math.PI * (first + (2 * corner) / count) + turned;
    const to = [x + Math.cos(angle) * reach * radius, y + Math.sin(angle) * reach * radius];
    if (corner) context.lineTo(...to);
    else context.moveTo(...to);
  }
  context.closePath();
}
