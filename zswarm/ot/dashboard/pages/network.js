// Draw a network: inputs at the left, outputs at the right, lines as thick as their weights.
import { number, s } from './page.js';

const LONGEST = 24; // letters of a name
const LISTED = 12; // connections of a node
const COLUMN = 150; // pixels between columns

// Draw nodes and edges; describe(text) is called for the node that is pointed at, with '' for none.
export function drawNetwork({ edges, nodes }, sensors, actuators, describe) {
  const names = nodes.map(({ kind, number: i }) => (
    { input: sensors, output: actuators }[kind]?.[i]
      ?? `${kind} ${i + (kind === 'state' ? 0 : 1)}`));
  const parts = Math.max(0, ...nodes.map((node) => node.part)) + 1;
  const { places, width, height } = nodes.some(({ kind }) => kind === 'state')
    ? circle(nodes.length) : grid(nodes, edges, names);
  const most = Math.max(1e-9, ...edges.map((edge) => Math.abs(edge.weight)));
  const drawn = [...edges].reverse().map((edge) => { // the strongest on top
    const share = Math.abs(edge.weight) / most;
    return { edge, path: s('path', {
      d: way(places[edge.source], places[edge.target], nodes[edge.source].kind === 'state'),
      class: edge.weight < 0 ? 'minus' : 'plus',
      'stroke-width': (0.4 + 3.6 * share).toFixed(2),
      'stroke-opacity': (0.15 + 0.8 * share).toFixed(2) }) };
  });

  function describeNode(i) {
    const { part, text } = nodes[i];
    const connections = (words, end, other) => {
      const found = drawn.filter(({ edge }) => edge[end] === i
        && (end === 'target' || edge.target !== i));
      const listed = found.reverse().slice(0, LISTED).map(({ edge }) => (
        `${names[edge[other]]} ${edge.text || number(edge.weight, 3)}`));
      return listed.length ? `; ${words} ${listed.join(', ')}` : '';
    };
    for (const { edge, path } of drawn) path.classList.toggle('faint',
      edge.source !== i && edge.target !== i);
    describe(`${names[i]}${parts > 1 ? ` of part ${part}` : ''}${text ? ` (${text})` : ''}${
      connections('hears', 'target', 'source')}${connections('leads to', 'source', 'target')}`);
  }

  function leave() {
    for (const { path } of drawn) path.classList.remove('faint');
    describe('');
  }

  const drawNode = ({ kind, number: i, text }, index) => {
    const [x, y] = places[index], name = names[index], label = {
      input: { x: x - 14, y: y + 4, 'text-anchor': 'end' }, output: { x: x + 14, y: y + 4 },
      hidden: { x, y: y - 13, 'text-anchor': 'middle' },
      state: { x, y: y + 4, 'text-anchor': 'middle' },
    }[kind];
    const shown = { hidden: String(i + 1), state: String(i) }[kind]
      ?? (name.length > LONGEST ? `${name.slice(0, LONGEST - 1)}…` : name);
    const enter = () => describeNode(index);
    return s('g', {
      class: 'node', tabindex: 0, role: 'img', 'aria-label': `${name} ${text}`,
      onpointerenter: enter, onpointerleave: leave, onfocus: enter, onblur: leave,
    }, kind === 'input' ? s('rect',
    { x: x - 8, y: y - 8, width: 16, height: 16, rx: 3, class: 'of-input' })
      : s('circle', { cx: x, cy: y, r: kind === 'state' ? 15 : 9, class: `of-${kind}` }),
      s('text', { ...label, text: shown }));
  };
  return s('svg', {
    class: 'network', viewBox: `0 0 ${width} ${height}`, role: 'img',
    'aria-label': `network of ${nodes.length} nodes and ${edges.length} connections${parts > 1 ? ` in ${parts} parts` : ''}`,
  }, s('g', {}, ...drawn.map(({ path }) => path)), ...nodes.map(drawNode));
}

// Place nodes in columns: inputs, hidden ones by their distance from the inputs, outputs.
function grid(nodes, edges, names) {
  const columns = layers(nodes, edges),
    tallest = Math.max(...columns.map((column) => column.length));
  const room = (kind) => 6.5 * Math.min(LONGEST,
    Math.max(0, ...names.filter((_, i) => nodes[i].kind === kind).map((name) => name.length)));
  const left = 28 + room('input'),
    width = left + COLUMN * (columns.length - 1) + 60 + room('output');
  const height = Math.max(120, tallest * (tallest > 24 ? 20 : 34) + 30), places = [];
  columns.forEach((column, c) => column.forEach((node, r) => {
    places[node] = [left + COLUMN * c, (r + 0.5) * height / column.length];
  }));
  return { places, width, height };
}

function layers(nodes, edges) {
  const kind = (i) => nodes[i].kind, depth = nodes.map((node) => (node.kind === 'input' ? 0 : 1));
  const back = new Set(edges.filter(({ source, target }) => source > target).map(({ source,
    target }) => `${target} ${source}`));
  const forward = edges.filter(({ source, target }) => source < target && kind(target) !== 'output'
    && kind(source) === 'hidden'
      && !back.has(`${source} ${target}`)); // two that hear each other share a column
  for (let i = 0; i < Math.min(12, nodes.length); i += 1) {
    for (const { source, target } of forward) depth[target] = Math.max(depth[target],
      Math.min(6, depth[source] + 1));
  }
  const last = Math.max(0, ...depth.filter((_, i) => kind(i) === 'hidden')) + 1;
  const columns = Array.from({ length: last + 1 }, () => []);
  nodes.forEach((node, i) => columns[node.kind === 'output' ? last : depth[i]].push(i));
  return columns.filter((column) => column.length);
}

function circle(count) {
  const [width, height, radius] = [520, 480, 190];
  const places = Array.from({ length: count }, (_, i) => {
    const turn = 2 * Math.PI * i / count - Math.PI / 2;
    return [width / 2 + radius * Math.cos(turn), height / 2 + radius * Math.sin(turn)];
  });
  return { places, width, height };
}

// Return the path of a connection.
function way([x1, y1], [x2, y2], bent) {
  if (x1 === x2 && y1 === y2) { // to itself
    return `M ${x1 - 6} ${y1 - 7} C ${x1 - 30} ${y1 - 42}, ${x1 + 30} ${y1 - 42}, ${x1 + 6} ${y1 - 7}`;
  }
  if (bent) { // so that there and back are two lines
    const [mx, my] = [(x1 + x2) / 2 + (y2 - y1) * 0.15, (y1 + y2) / 2 - (x2 - x1) * 0.15];
    return `M ${x1} ${y1} Q ${mx} ${my} ${x2} ${y2}`;
  }
  if (Math.abs(x1 - x2) < 1) return `M ${x1} ${y1} C ${x1 + 55} ${y1}, ${x2 + 55} ${y2}, ${x2} ${y2}`;
  const middle = (x1 + x2) / 2, bend = x2 < x1 ? 60 : 0; // lines back pass below
  return `M ${x1} ${y1} C ${middle} ${y1 + bend}, ${middle} ${y2 + bend}, ${x2} ${y2}`;
}
