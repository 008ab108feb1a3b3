// All runs: a table, and the curves of the chosen ones, overlaid or as median and quartiles.
import { Chart, nearest } from './chart.js';
import { follow } from './live.js';
import { SortedTable, ago, api, ask, badge, between, button, card, choice, fill, h, n, number, row,
  rowHead, table, tr, unlessGone } from './page.js';

const CHOSEN = 'zswarm.chosen';
const MOST = 14; // curves at once
const FRESH_MS = 3000; // between requests for a curve
const POINTS = 200; // of medians and quartiles
const HEADS = [
  ['', ''], ['run', 'name'], ['state', 'status'], ['generation', 'generation', 'n'],
  ['best', 'best', 'n'], ['evaluations', 'evaluations', 'n'], ['simulator', 'simulator'],
  ['network', 'representation'], ['optimizer', 'optimizer'], ['seed', 'seed', 'n'],
  ['last', 'at', 'n'],
];
const AXES = {
  generation: 'generation', evaluations: 'evaluations', time: 'since the first generation',
};

export async function show(view) {
  const page = new RunsPage(view);
  follow('', (message) => page.receive(message));
  setInterval(() => page.load(), FRESH_MS);
}

class RunsPage {
  constructor(view) {
    this.runs = new Map();
    this.curves = new Map(); // by id: columns, and when they were requested
    this.chosen = new Set(JSON.parse(sessionStorage.getItem(CHOSEN) ?? '[]'));
    this.shown = { what: 'best', axis: 'generation', grouped: 'each' };
    this.chart = new Chart({ label: 'Fitness of the chosen runs', height: 320,
      hint: 'drag to zoom, arrows to read' });
    this.table = new SortedTable('runs', HEADS, ['at', -1], (run) => this.runRow(run),
      'no run yet: start one with zswarm-ot run, and it appears here');
    this.compared = h('div');
    this.differences = h('details', { hidden: true, ontoggle: () => this.compare() },
      h('summary', { text: 'what differs' }), this.compared);
    fill(view, h('h1', { text: 'Runs' }), this.buildCurves(), card('All runs',
      between(this.table.filter, this.table.count), this.table.element));
  }

  buildCurves() {
    const choose = (label, name, options) => choice(label, options, this.shown[name], (value) => {
      this.shown[name] = value;
      this.draw();
    });
    return h('section', { class: 'card', 'aria-label': 'Curves' },
      between(
        row(choose('Fitness', 'what', [['best', 'best'], ['mean', 'mean']]),
          choose('Along', 'axis', [['generation', 'generations'], ['evaluations', 'evaluations'],
            ['time', 'wall time']]),
          choose('Runs', 'grouped', [['each', 'each run'], ['together', 'median and quartiles']])),
        row(button('none', () => this.choose([], false)),
          button('PNG', () => this.chart.png('runs.png')))),
      this.chart.element, this.differences);
  }

  // Draw runs, or none but these.
  choose(ids, more) {
    this.chosen = new Set([...(more ? this.chosen : []), ...ids]);
    sessionStorage.setItem(CHOSEN, JSON.stringify([...this.chosen]));
    for (const box of this.table.body.querySelectorAll('input')) {
      box.checked = this.chosen.has(box.value);
    }
    this.load();
  }

  runRow(run) {
    const { id, generation, generations } = run, name = pathOf(run);
    if (run.error) {
      return tr('', [name, 'name'], badge('unreadable'),
        h('td', { class: 'why', colspan: 8, text: run.error }));
    }
    const box = h('input', {
      type: 'checkbox', value: id, checked: this.chosen.has(id), 'aria-label': `draw ${run.name}`,
      onchange: () => {
        this.chosen.delete(id);
        this.choose(box.checked ? [id] : [], true);
      } });
    const link = h('a', { href: `/run?${new URLSearchParams({ run: id })}`, text: name });
    return tr(box, h('td', { class: 'name' }, link), badge(run.status),
      [`${number(generation)} / ${number(generations)}`, 'n'], n(run.best), n(run.evaluations),
      run.simulator, run.representation, run.optimizer, [String(run.seed), 'n'],
      h('td', { class: 'n' }, ago(run.at)));
  }

  // Return the chosen runs that can be drawn.
  drawn() {
    const found = [...this.chosen].map((id) => this.runs.get(id));
    return found.filter((row) => row && !row.error).slice(0, MOST);
  }

  async load() {
    const now = performance.now();
    await Promise.all(this.drawn().map(async ({ id, generation }) => {
      const have = this.curves.get(id) ?? { asked: -Infinity };
      if (have.generation === generation || now - have.asked <= FRESH_MS) return;
      this.curves.set(id, { ...have, generation, asked: now });
      try {
        this.curves.get(id).columns = await ask(api('curve', { points: 600 }, id));
      } catch { /* the table says why */ }
    }));
    this.draw();
    this.compare();
  }

  // Show the settings in which the chosen runs differ, and their results.
  async compare() {
    const runs = this.drawn();
    this.differences.hidden = runs.length < 2;
    if (!this.differences.open || this.differences.hidden) return;
    const asked = () => Promise.all(runs.map(({ id }) => ask(api('settings', {}, id))));
    const each = await unlessGone(asked);
    if (!each) return;
    const differs = (key) => each.some((one) => one[key] !== each[0][key]);
    const keys = [...new Set(each.flatMap(Object.keys))].filter(differs);
    const rows = [
      ...keys.map((key) => [key, each.map((one) => one[key] ?? '–')]),
      ...['best', 'generation', 'evaluations'].map((key) => [key,
        runs.map((row) => number(row[key]))]),
    ];
    fill(this.compared, table(['', ...runs.map(pathOf)],
      rows.map(([name, values]) => [rowHead(name), ...values.map((text) => [text, 'wrap'])])));
  }

  draw() {
    const { what, axis, grouped } = this.shown;
    const along = {
      generation: ({ generation }) => generation.map((value) => value + 1),
      evaluations: ({ evaluations }) => evaluations,
      time: ({ at }) => at.map((then) => then - at[0]),
    }[axis];
    const all = this.drawn().map((row) => [row, this.curves.get(row.id)?.columns])
      .filter(([, columns]) => columns?.generation.length)
      .map(([row, columns]) => ({ name: pathOf(row), x: along(columns), y: columns[what],
        steps: what === 'best' }));
    this.chart.set(grouped === 'each' || all.length < 2 ? all : together(all),
      { xLabel: AXES[axis], time: axis === 'time' });
  }

  receive(message) {
    if (message.hello) this.runs.clear();
    for (const row of message.runs ?? []) this.runs.set(row.id, row);
    for (const id of message.gone ?? []) this.runs.delete(id);
    const rows = [...this.runs.values()];
    this.table.show(rows);
    if (!sessionStorage.getItem(CHOSEN) && rows.length) {
      const last = rows.filter((row) => row.generation).sort((a, b) => (b.at ?? 0) - (a.at ?? 0));
      this.choose(last.slice(0, 5).map((row) => row.id), true);
    } else if (message.runs || message.gone) {
      this.load();
    }
  }
}

function pathOf({ study, name }) {
  return study ? `${study.replaceAll('~', '/')}/${name}` : name;
}

// Return median and quartiles over the runs that reach each point.
function together(all) {
  const begin = Math.min(...all.map(({ x }) => x[0]));
  const end = Math.max(...all.map(({ x }) => x.at(-1)));
  const x = Array.from({ length: POINTS }, (_, i) => begin + (end - begin) * i / (POINTS - 1));
  const columns = { low: [], median: [], high: [] };
  for (const at of x) {
    const values = all.filter((one) => one.x[0] <= at && at <= one.x.at(-1))
      .map((one) => valueAt(one, at)).filter((y) => y !== null).sort((a, b) => a - b);
    const several = values.length > 1;
    columns.low.push(several ? quantile(values, 0.25) : null);
    columns.median.push(values.length ? quantile(values, 0.5) : null);
    columns.high.push(several ? quantile(values, 0.75) : null);
  }
  return [
    { name: 'quartiles', x, low: columns.low, high: columns.high, ink: '--c1' },
    { name: `median of ${all.length} runs`, x, y: columns.median, ink: '--c1', dash: null },
    ...all.map((one) => ({ ...one, ink: '--dim', thin: true, dash: '2 3' })),
  ];
}

function valueAt({ x, y }, at) {
  const i = nearest(x, at);
  return y[x[i] > at ? i - 1 : i];
}

function quantile(sorted, share) {
  const at = (sorted.length - 1) * share, below = Math.floor(at);
  return sorted[below] + (at - below) * ((sorted[below + 1] ?? sorted[below]) - sorted[below]);
}
