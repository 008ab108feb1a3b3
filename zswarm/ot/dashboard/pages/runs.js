// All runs: a table, and the curves of the chosen ones, overlaid or as median and quartiles.
import { Chart, nearest } from './chart.js';
import { showImportance } from './importance.js';
import { follow } from './live.js';
import { SortedTable, ago, ask, badge, between, button, card, choice, fill, h, n, number, row,
  rowHead, table, tr, unlessGone } from './page.js';

const CHOSEN = 'zswarm.chosen';
const MOST = 14; // curves at once; medians are of all
const FRESH_MS = 3000; // between requests for a curve
const POINTS = 200; // of medians and quartiles, and of many curves
const AT_ONCE = 50; // runs in a request for curves
// Settings in which runs of one median may differ.
const FREE = new Set(['seed', 'generations']);
const HEADS = [
  ['', ''], ['run', 'name'], ['state', 'status'], ['generation', 'generation', 'n'],
  ['best in search', 'best', 'n'], ['held-out', 'held_out', 'n'], ['evaluations', 'evaluations', 'n'], ['simulator', 'simulator'],
  ['network', 'representation'], ['optimizer', 'optimizer'], ['seed', 'seed', 'n'],
  ['last', 'at', 'n'],
];
const RESULTS = [['best in search', 'best'], ['champion, held-out', 'held_out'],
  ['generation', 'generation'], ['evaluations', 'evaluations']];
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
    this.settings = new Map(); // by id: those that the history depends on
    const linked = new URLSearchParams(location.search); // a link that reproduces the selection
    if (linked.has('runs')) {
      sessionStorage.setItem(CHOSEN, JSON.stringify(linked.get('runs').split(' ').filter(Boolean)));
    }
    this.chosen = new Set(JSON.parse(sessionStorage.getItem(CHOSEN) ?? '[]'));
    this.shown = { what: 'best', axis: 'generation', grouped: 'each', scale: 'linear' };
    for (const key of Object.keys(this.shown)) this.shown[key] = linked.get(key) ?? this.shown[key];
    this.charts = new Map(); // by simulator: fitness of different problems does not compare
    this.figures = h('div');
    this.studies = h('div', { class: 'row' });
    this.table = new SortedTable('runs', HEADS, ['at', -1], (run) => this.runRow(run),
      'no run yet: start one with zswarm-ot run, and it appears here');
    this.left = h('p', { class: 'why', 'aria-live': 'polite' });
    this.compared = h('div');
    this.differences = h('details', { hidden: true, ontoggle: () => this.compare() },
      h('summary', { text: 'what differs' }), this.compared);
    this.explained = h('div');
    this.importance = h('details', { hidden: true, ontoggle: () => this.explain() },
      h('summary', { text: 'importance of settings' }), this.explained);
    this.unit = h('p', { class: 'dim small', hidden: true,
      text: 'fitness is the mean of a candidate\'s trials' });
    fill(view, h('h1', { text: 'Runs' }), this.unit, this.buildCurves(), card('All runs',
      between(row(this.table.filter, button('tick shown', () => this.tick(this.table.found)),
        button('none', () => this.choose([], false))), this.table.count),
      this.studies, this.table.element));
  }

  tick(runs) {
    this.choose(runs.filter((run) => !run.error).map((run) => run.id), true);
  }

  // Offer each study as a group: a click draws its runs alone.
  showStudies(rows) {
    const studies = new Map();
    for (const run of rows) {
      if (run.study && !run.error) {
        studies.set(run.study, [...(studies.get(run.study) ?? []), run.id]);
      }
    }
    const names = [...studies].map(([study, ids]) => `${study} ${ids.length}`).join();
    if (names === this.offered) return;
    this.offered = names;
    fill(this.studies, ...[...studies.keys()].sort().map((study) => button(
      `${study.replaceAll('~', '/')} (${studies.get(study).length})`,
      () => this.choose(studies.get(study), false), { class: 'small',
        title: 'draw the runs of this study alone' })));
  }

  // Return the chart of a simulator, which is made when it is first needed.
  chartOf(simulator) {
    if (!this.charts.has(simulator)) {
      const chart = new Chart({ label: `Fitness of the chosen runs: ${simulator}`, height: 320,
        hint: 'drag to zoom, arrows to read' });
      const heading = h('h2', { class: 'problem', text: simulator });
      const figure = h('div', {}, heading, chart.element);
      this.figures.append(figure);
      this.charts.set(simulator, { chart, heading, figure });
    }
    return this.charts.get(simulator);
  }

  async png() {
    for (const [simulator, { chart, figure }] of this.charts) {
      if (!figure.hidden) await chart.png(`runs-${simulator}.png`);
    }
  }

  buildCurves() {
    const choose = (label, name, options) => choice(label, options, this.shown[name], (value) => {
      this.shown[name] = value;
      this.link();
      this.load();
    });
    return h('section', { class: 'card', 'aria-label': 'Curves' },
      between(
        row(choose('Fitness', 'what', [['best', 'best'], ['mean', 'mean']]),
          choose('Along', 'axis', [['generation', 'generations'], ['evaluations', 'evaluations'],
            ['time', 'wall time']]),
          choose('Axis', 'scale', [['linear', 'linear'], ['log', 'logarithmic']]),
          choose('Runs', 'grouped', [['each', 'each run'], ['together', 'median and quartiles']])),
        row(button('PNG', () => this.png()))),
      this.figures, this.left, this.importance, this.differences);
  }

  // Draw runs, or none but these, and have the address reproduce it.
  choose(ids, more) {
    this.keep([...(more ? this.chosen : []), ...ids]);
    this.link();
  }

  keep(ids) {
    this.chosen = new Set(ids);
    sessionStorage.setItem(CHOSEN, JSON.stringify([...this.chosen]));
    for (const box of this.table.body.querySelectorAll('input')) {
      box.checked = this.chosen.has(box.value);
    }
    this.load();
  }

  link() {
    const found = new URLSearchParams({ ...this.shown, runs: [...this.chosen].join(' ') });
    history.replaceState(null, '', `?${found}`);
  }

  runRow(run) {
    const { id, generation, generations } = run, name = pathOf(run);
    if (run.error) {
      return tr('', [name, 'name'], badge('unreadable'),
        h('td', { class: 'why', colspan: 9, text: run.error }));
    }
    const box = h('input', {
      type: 'checkbox', value: id, checked: this.chosen.has(id), 'aria-label': `draw ${run.name}`,
      onchange: () => {
        this.chosen.delete(id);
        this.choose(box.checked ? [id] : [], true);
      } });
    const link = h('a', { href: `/run?${new URLSearchParams({ run: id })}`, text: name });
    const marks = run.tags.length || run.note ? h('div', { class: 'small dim' },
      ...run.tags.map((text) => h('span', { class: 'tag', text })), run.note.split('\n')[0]) : null;
    return tr(box, h('td', { class: 'name' }, link, marks), badge(run.status),
      [`${number(generation)} / ${number(generations)}`, 'n'], n(run.best), n(run.held_out),
      n(run.evaluations), run.simulator, run.representation, run.optimizer, [String(run.seed), 'n'],
      h('td', { class: 'n' }, ago(run.at)));
  }

  // Return the chosen runs that are drawn.
  drawn() {
    const found = [...this.chosen].map((id) => this.runs.get(id))
      .filter((row) => row && !row.error);
    const drawn = this.shown.grouped === 'each' ? found.slice(0, MOST) : found;
    this.left.textContent = drawn.length < found.length
      ? `${drawn.length} of ${found.length} chosen runs are drawn; the median has all` : '';
    return drawn;
  }

  async load() {
    const now = performance.now();
    const drawn = this.drawn(), needed = drawn.filter(({ id, generation }) => {
      const have = this.curves.get(id) ?? { asked: -Infinity };
      if (have.generation === generation || now - have.asked <= FRESH_MS) return false;
      this.curves.set(id, { ...have, generation, asked: now });
      return true;
    });
    const points = drawn.length > MOST ? POINTS : 600, parts = [];
    for (let i = 0; i < needed.length; i += AT_ONCE) parts.push(needed.slice(i, i + AT_ONCE));
    await unlessGone(() => Promise.all(parts.map(async (part) => {
      const runs = part.map(({ id }) => id).join(' ');
      const found = await ask(`/api/curves?${new URLSearchParams({ points, runs })}`);
      for (const [id, { curve, label, settings }] of Object.entries(found)) {
        Object.assign(this.curves.get(id), { columns: curve, label });
        this.settings.set(id, settings);
      }
    })));
    this.draw();
    this.explain();
    this.compare();
  }

  // Show which settings explain the fitness of the chosen runs, all of one problem.
  explain() {
    const runs = [...this.chosen].map((id) => this.runs.get(id)).filter((row) => row && !row.error);
    const problems = new Set(runs.map(({ simulator }) => simulator));
    this.importance.hidden = runs.length < 2 || problems.size > 1;
    if (this.importance.hidden || !this.importance.open) return;
    const key = runs.map(({ id, best }) => `${id} ${best}`).join();
    if (key === this.explainedOf) return;
    this.explainedOf = key;
    showImportance(this.explained, runs);
  }

  // Show the settings in which the chosen runs differ, and their results.
  compare() {
    const runs = this.drawn();
    this.differences.hidden = runs.length < 2;
    if (!this.differences.open || this.differences.hidden) return;
    const each = runs.map(({ id }) => this.settings.get(id) ?? {});
    const differs = (key) => each.some((one) => one[key] !== each[0][key]);
    const keys = [...new Set(each.flatMap(Object.keys))].filter(differs);
    const rows = [
      ...keys.map((key) => [key, each.map((one) => one[key] ?? '–')]),
      ...RESULTS.map(([label, key]) => [label, runs.map((row) => number(row[key]))]),
    ];
    fill(this.compared, table(['', ...runs.map(pathOf)],
      rows.map(([name, values]) => [rowHead(name), ...values.map((text) => [text, 'wrap'])])));
  }

  draw() {
    const { what, axis, grouped, scale } = this.shown;
    const along = {
      generation: ({ generation }) => generation.map((value) => value + 1),
      evaluations: ({ evaluations }) => evaluations,
      time: ({ at }) => at.map((then) => then - at[0]),
    }[axis];
    const all = this.drawn().map((row) => [row, this.curves.get(row.id)?.columns])
      .filter(([, columns]) => columns?.generation.length)
      .map(([row, columns]) => ({ name: pathOf(row), x: along(columns), y: columns[what],
        steps: what === 'best', settings: this.settings.get(row.id) ?? {},
        label: this.curves.get(row.id).label,
        simulator: row.simulator }));
    const problems = new Set(all.map(({ simulator }) => simulator));
    if (!problems.size) problems.add([...this.charts.keys()][0] ?? '');
    problems.forEach((simulator) => this.chartOf(simulator));
    for (const [simulator, { chart, heading, figure }] of this.charts) {
      const runs = all.filter((one) => one.simulator === simulator);
      figure.hidden = !problems.has(simulator);
      heading.hidden = problems.size < 2;
      chart.set(grouped === 'each' || runs.length < 2 ? runs : medians(runs),
        { xLabel: AXES[axis], time: axis === 'time', log: scale === 'log' });
    }
  }

  receive(message) {
    if (message.hello) this.runs.clear();
    for (const row of message.runs ?? []) this.runs.set(row.id, row);
    for (const id of message.gone ?? []) this.runs.delete(id);
    const rows = [...this.runs.values()];
    this.table.show(rows);
    this.unit.hidden = !rows.some((row) => row.fitness_trials > 1);
    this.showStudies(rows);
    if (!sessionStorage.getItem(CHOSEN) && rows.length) {
      const last = rows.filter((row) => row.generation).sort((a, b) => (b.at ?? 0) - (a.at ?? 0));
      this.keep(last.slice(0, 5).map((row) => row.id));
    } else if (message.runs || message.gone) {
      this.load();
    }
  }
}

function pathOf({ study, name }) {
  return study ? `${study.replaceAll('~', '/')}/${name}` : name;
}

// Return median and quartiles of the runs of each setting; runs alone in theirs stay as they are.
function medians(all) {
  const same = new Map();
  for (const one of all) {
    const kept = Object.entries(one.settings).filter(([key]) => !FREE.has(key));
    const key = JSON.stringify(kept);
    same.set(key, [...(same.get(key) ?? []), one]);
  }
  const groups = [...same.values()], [{ settings: first }] = all;
  const differs = Object.keys(first).filter((key) => !FREE.has(key)
    && all.some(({ settings }) => settings[key] !== first[key]));
  return groups.flatMap((runs, i) => {
    if (runs.length < 2) return runs;
    const values = runs[0].label || differs
      .map((key) => `${key.split('.').at(-1)} ${runs[0].settings[key] ?? '–'}`).join(', ');
    const words = groups.length > 1 && values ? `: ${values}` : '';
    return together(runs, words, `--c${(i % 7) + 1}`);
  });
}

// Return median and quartiles over runs, up to where the first of them ends.
function together(runs, words, ink) {
  const begin = Math.max(...runs.map(({ x }) => x[0]));
  const end = Math.min(...runs.map(({ x }) => x.at(-1)));
  const x = Array.from({ length: POINTS }, (_, i) => begin + (end - begin) * i / (POINTS - 1));
  const columns = { low: [], median: [], high: [] };
  for (const at of x) {
    const values = runs.map((one) => valueAt(one, at)).filter((y) => y !== null)
      .sort((a, b) => a - b);
    columns.low.push(values.length ? quantile(values, 0.25) : null);
    columns.median.push(values.length ? quantile(values, 0.5) : null);
    columns.high.push(values.length ? quantile(values, 0.75) : null);
  }
  return [
    { name: `quartiles${words}`, x, low: columns.low, high: columns.high, ink },
    { name: `median of ${runs.length} runs${words}`, x, y: columns.median, ink, dash: null },
    ...runs.map((one) => ({ ...one, ink: '--dim', thin: true, dash: '2 3',
      unnamed: runs.length > MOST })),
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
