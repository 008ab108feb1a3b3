// One run: its progress, curves, events, champions and experiment, and the requests that it takes.
import { annotationsCard } from './annotations.js';
import { Chart, nearest } from './chart.js';
import { follow } from './live.js';
import { TAKES_TOKEN, address, ago, api, ask, badge, between, button, card, choice, clock, copyButton, download,
  duration, fill, h, n, note, number, request, row, rowHead, run, section, setText, showError, table,
  throttled, token, two, unitOf, unlessGone } from './page.js';

const MOST = 4000; // points of a curve, from which on it is read again in fewer
const SLOW_MS = 4000; // between requests that read all candidates
const EVENTS = 300; // with which a page begins
const MOST_EVENTS = 5000;
const SHOWN_EVENTS = 2000;
const CHAMPIONS = 100;
const AS_RECORDED = 'as in the record: fitness is the sum of a candidate\'s trials';
const LEVELS = { info: '·', warning: '▲', error: '✕' };
const CHARTS = { diversity_: 'Diversity', effectivity_: 'Effectivity of operators',
  '': 'Other numbers of the optimizer' };
const EXCLUDED = /^(diversity_|effectivity_|count_|best$|mean$|evaluations$)/; // of the other numbers
const CONTROLS = { // texts, classes, and questions
  pause: ['Pause'],
  continue: ['Resume', 'main'],
  drain: ['Stop after this generation'],
  stop: ['Stop', 'danger', 'Stop this run? Nothing is lost: zswarm-ot resume continues it.'],
};

export async function show(view) {
  await new RunPage(view).begin();
}

class RunPage {
  constructor(view) {
    this.about = null;
    this.state = { status: 'reading' };
    this.axis = 'generation';
    this.curve = { generation: [], at: [], best: [], mean: [], low: [], high: [], evaluations: [] };
    this.spread = null;
    this.statistics = null;
    this.track = null; // the best of some generations on held-out seeds
    this.events = [];
    this.level = 'info';
    this.loaded = false; // everything, once
    this.tried = false;
    this.loadSlow = throttled(SLOW_MS, async () => {
      [this.spread, this.statistics, this.track] = await Promise.all([ask(api('spread')),
        ask(api('statistics')), ask(api('track'))]);
      this.draw();
      await this.loadChampions();
    });
    this.panel = card('What was run');
    this.champions = h('div');
    this.annotations = h('div'); // made once: what is typed there stays
    this.charts = Object.entries(CHARTS).map(([prefix, label]) => {
      const chart = new Chart({ label, height: 200 }), element = card(label, chart.element);
      element.hidden = true; // until the optimizer has such numbers
      return { prefix, chart, element };
    });
    fill(view, this.buildHead(), this.buildFitness(), two(...this.charts.map(({ element }) => element)),
      two(h('div', { class: 'stack' }, this.buildEvents(), card('Champions', this.champions)),
        h('div', { class: 'stack' }, this.annotations, this.panel)));
  }

  buildHead() {
    this.title = h('h1', { text: run });
    this.status = h('span', {}, badge('reading'));
    this.controls = row();
    this.notes = h('div');
    this.progress = h('progress', { max: 1, value: 0, 'aria-label': 'generations done' });
    this.inner = h('p', { class: 'dim small' });
    this.tiles = h('dl', { class: 'tiles' });
    return section(between(row(this.title, this.status), this.controls),
      this.notes, this.progress, this.inner, this.tiles);
  }

  buildFitness() {
    this.fitness = new Chart({
      label: 'Fitness: best, mean, and quartiles of the candidates', height: 320,
      hint: 'drag to zoom, click or Enter to choose a generation',
      onpick: (value) => this.pick(value) });
    this.picked = h('p', { class: 'small' });
    const axes = [['generation', 'generations'], ['time', 'wall time']];
    const tools = row(
      choice('Along', axes, this.axis, (value) => {
        this.axis = value;
        this.draw();
      }),
      download('CSV', api('history.csv'), `${run}.csv`, AS_RECORDED),
      download('JSON', api('history.json'), `${run}.json`, AS_RECORDED),
      button('PNG', () => this.fitness.png(`${run}.png`)));
    this.unit = h('span', { class: 'dim small' });
    return section(between(row(h('h2', { text: 'Fitness' }), this.unit), tools), this.fitness.element, this.picked);
  }

  buildEvents() {
    this.log = h('ul', { class: 'log' });
    this.older = button('older ones', () => this.loadOlder(), { class: 'small' });
    const levels = [['info', 'all'], ['warning', 'warnings'], ['error', 'errors']];
    const chosen = choice('Show', levels, this.level, (value) => {
      this.level = value;
      this.showEvents();
    });
    return section(between(h('h2', { text: 'Events' }), chosen),
      h('div', { class: 'scroll' }, this.log), this.older);
  }

  // ---- showing

  along(columns) {
    if (this.axis === 'generation') return columns.generation.map((value) => value + 1);
    const began = this.about?.began ?? this.curve.at[0];
    return columns.at.map((at) => at - began);
  }

  draw() {
    const { curve, spread, statistics } = this, time = this.axis === 'time';
    const options = { xLabel: time ? 'since the run began' : 'generation', time };
    const x = this.along(curve), sparse = curve.low.some((low, i) => low !== curve.high[i]);
    const bands = spread?.generation.length ? this.along(spread) : null;
    this.fitness.set([
      bands && { name: 'quartiles', x: bands, low: spread.lower, high: spread.upper, ink: '--c3' },
      !spread && sparse && { name: 'range of means', x, low: curve.low, high: curve.high,
        ink: '--c2' },
      ...this.heldOut(x),
      { name: 'best in search', x, y: curve.best, ink: '--c1', dash: null, steps: true },
      { name: 'mean', x, y: curve.mean, ink: '--c2', dash: '7 4' },
      bands && { name: 'median', x: bands, y: spread.median, ink: '--c3', dash: '2 3' },
    ].filter(Boolean), options);
    const xs = statistics && this.along(statistics), all = Object.entries(statistics?.values ?? {});
    for (const { prefix, chart, element } of this.charts) {
      const own = all.filter(([name]) => (prefix ? name.startsWith(prefix)
        : !EXCLUDED.test(name))).slice(0, 14);
      element.hidden = !own.length;
      chart.set(own.map(([name, y]) => ({ name: name.slice(prefix.length), x: xs, y })), options);
    }
  }

  // Return the champion's level and the tracked generations' curve, each with its 95 % interval.
  heldOut(x) {
    const { track, state: { champion } } = this, lines = [];
    if (track?.generation.length) {
      const at = this.along(track);
      lines.push({ name: 'best, held-out 95 %', x: at, low: track.low, high: track.high,
        ink: '--c4' }, { name: 'best, held-out', x: at, y: track.mean, ink: '--c4', dash: null });
    }
    if (champion && x.length) {
      const ends = [x[0], x.at(-1)], twice = (value) => [value, value];
      lines.push({ name: 'champion, held-out 95 %', x: ends, low: twice(champion.low),
        high: twice(champion.high), ink: '--c5' }, { name: 'champion, held-out', x: ends,
        y: twice(champion.mean), ink: '--c5', dash: '10 3 2 3' });
    }
    return lines;
  }

  showState() {
    const { state } = this, { champion } = state, done = state.generation ?? 0, running = state.status === 'running';
    fill(this.status, badge(state.status));
    if (state.error) fill(this.notes, note(state.error));
    if (!('generation' in state)) return;
    setText(this.unit, unitOf(state.fitness_trials));
    const counted = Math.min(state.counted, state.trials);
    this.progress.max = state.generations || 1;
    this.progress.value = done + (state.trials ? counted / state.trials : 0);
    const trials = done < state.generations
      ? `generation ${done + 1}: ${number(counted)} of ${number(state.trials)} trials`
      : `assessment: ${number(counted)} of at most ${number(state.trials)} trials`;
    const last = state.at ? ['last recorded ', ago(state.at)] : [];
    fill(this.inner, ...(running && state.trials ? [trials] : last));
    const rate = state.rate === null ? `${number(state.trial_rate)} games/s`
      : number(state.rate, 3);
    const values = {
      generation: `${number(done)} / ${number(state.generations)}`, 'best in search': number(state.best),
      'champion, held-out': number(champion?.mean ?? null),
      ...champion && { 'its 95 %': `${number(champion.low)} to ${number(champion.high)}` },
      mean: number(state.mean), evaluations: number(state.evaluations),
      'evaluations/s': running ? rate : '–', 'time left': duration(state.eta_s),
      servers: number(state.servers), slots: number(state.slots),
      'sent again': number(state.requeued),
    };
    fill(this.tiles, ...Object.entries(values).map(([name, text]) => (
      h('div', { class: 'tile' }, h('dt', { text: name }), h('dd', { text })))));
    this.showControls();
  }

  showControls() {
    const { running, asked } = this.state, allowed = Boolean(token()), key = `${running} ${asked}`;
    if (this.controls.dataset.key === key) return;
    this.controls.dataset.key = key;
    const names = running ? [asked ? 'continue' : 'pause', 'drain', 'stop'] : [];
    fill(this.controls, ...names.map((name) => {
      const [text, kind, question] = CONTROLS[name];
      return button(text, () => this.control(name, question), {
        class: kind, disabled: !allowed,
        title: allowed ? null : TAKES_TOKEN });
    }));
  }

  async control(name, question) {
    if (question && !confirm(question)) return;
    try {
      await request(api(`control/${name}`), 'POST');
    } catch (error) {
      fill(this.notes, note(error.message));
    }
  }

  showEvents() {
    const levels = Object.keys(LEVELS), least = levels.indexOf(this.level);
    const shown = this.events.filter(({ level }) => levels.indexOf(level) >= least);
    const items = shown.slice(-SHOWN_EVENTS).reverse().map(eventItem);
    fill(this.log, ...(items.length ? items : [h('li', { class: 'dim', text: 'none' })]));
  }

  pick(value) {
    const generation = this.curve.generation[nearest(this.along(this.curve), value)];
    const link = h('a', { href: address('/candidate', { generation }),
      text: 'look at its best candidate' });
    fill(this.picked, `generation ${generation + 1}: `, link);
  }

  showAbout() {
    const { experiment, facts, name } = this.about;
    document.title = `${name} · zswarm`;
    setText(this.title, name);
    if (!this.annotations.childElementCount) fill(this.annotations, annotationsCard(this.about));
    fill(this.panel, h('h2', { text: 'What was run' }),
      row(copyButton('copy experiment', experiment), copyButton('copy seed', facts.seed),
        facts.history && copyButton('copy history hash', facts.history)),
      table([], Object.entries(facts).map(([key, value]) => [rowHead(key), [value, 'wrap']])),
      h('h3', { text: 'experiment.toml' }), h('pre', { text: experiment, tabindex: 0 }));
  }

  // ---- loading

  async loadAbout() {
    this.about = await ask(api('about'));
    this.showAbout();
    fill(this.notes, ...(await ask(api('caveats'))).map((text) => note(text)));
  }

  async loadChampions() {
    const found = (await ask(api('champions'))).reverse().slice(0, CHAMPIONS);
    const rows = found.map(({ generation, candidate, fitness }) => [
      n(generation + 1), n(candidate), n(fitness),
      h('a', { href: address('/candidate', { generation, candidate }), text: 'look' })]);
    fill(this.champions, rows.length
      ? table([['generation', 'n'], ['candidate', 'n'], ['fitness', 'n'], ''], rows)
      : note('none yet', 'dim'));
  }

  async loadCurve() {
    const loaded = await ask(api('curve')), last = loaded.generation.at(-1) ?? -1;
    const late = this.curve.generation.findIndex((generation) => generation > last);
    if (late >= 0) { // these came while it was loaded
      for (const name of Object.keys(loaded)) loaded[name].push(...this.curve[name].slice(late));
    }
    this.curve = loaded;
    this.draw();
  }

  async loadOlder() {
    const before = this.events.length ? { before: this.events[0].id } : {};
    const found = await ask(api('events', before));
    this.events = [...found.reverse(), ...this.events];
    this.older.hidden = !found.length;
    this.showEvents();
  }

  async loadAll() {
    await unlessGone(async () => {
      await this.loadCurve();
      await this.loadAbout();
      this.loaded = true;
      await this.loadSlow(true);
    }).catch((error) => showError(error.message));
  }

  // ---- following

  async begin() {
    follow(run, (message) => this.receive(message));
    await this.loadAll();
    this.tried = true;
  }

  receive(message) {
    const { events, generations = [], hello, state } = message;
    if (state) {
      const ended = this.state.status === 'running' && state.status !== 'running';
      this.state = state;
      this.showState();
      if (ended) unlessGone(async () => { await this.loadAbout(); await this.loadSlow(true); });
    }
    if (hello) {
      this.older.hidden = events.length < EVENTS;
      if (this.loaded) unlessGone(() => this.loadCurve()); else if (this.tried) this.loadAll();
    }
    if (events) {
      this.events = [...(hello ? [] : this.events), ...events].slice(-MOST_EVENTS);
      this.showEvents();
    }
    for (const [generation, at, best, mean, evaluations] of generations) {
      if (generation <= (this.curve.generation.at(-1) ?? -1)) continue;
      const row = { generation, at, best, mean, low: mean, high: mean, evaluations };
      for (const [name, value] of Object.entries(row)) this.curve[name].push(value);
    }
    if (!generations.length) return;
    if (this.curve.generation.length > MOST) unlessGone(() => this.loadCurve()); else this.draw();
    if (this.loaded) unlessGone(() => this.loadSlow());
  }
}

function eventItem({ at, generation, event, level, server, text, count }) {
  const times = count ? ` (${number(count)})` : '';
  return h('li', {},
    h('span', { class: 'when', text: clock(at),
      title: generation === null ? null : `generation ${generation + 1}` }),
    h('span', { class: level, text: LEVELS[level], 'aria-label': level, role: 'img' }),
    h('span', { class: `what ${level}`, text: event.replaceAll('_', ' ') + times }),
    h('span', { class: 'detail wrap', text: [server, text].filter(Boolean).join(': ') }));
}
