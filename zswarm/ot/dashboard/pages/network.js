// A network as a drawing: inputs at the left, outputs at the right, lines as thick as their weights.
import { number } from './page.js';

const SVG = 'http://www.w3.org/2000/svg';

function s(tag, properties = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(properties)) if (value !== undefined) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

export function nameOf(node, sensors, actuators) {
  const names = node.kind === 'input' ? sensors : node.kind === 'output' ? actuators : [];
  return names[node.number] ?? `${node.kind} ${node.number + (node.kind === 'state' ? 0 : 1)}`;
}

// Nodes and edges as the dashboard gives them; say(text) is called for what is pointed at.
export function drawNetwork(graph, sensors, actuators, say) {
  const parts = Math.max(0, ...graph.nodes.map((node) => node.part)) + 1;
  const states = graph.nodes.some((node) => node.kind === 'state');
  const columns = states ? null : layout(graph);
  const tallest = states ? 8 : Math.max(...columns.map((column) => column.length));
  const longest = (kind) => Math.min(24, Math.max(0, ...graph.nodes.filter((node) => node.kind === kind).map((node) => nameOf(node, sensors, actuators).length)));
  const [left, right] = [28 + 6.5 * longest('input'), 60 + 6.5 * longest('output')];
  const width = states ? 520 : left + 150 * (columns.length - 1) + right;
  const gap = tallest > 24 ? 20 : 34;
  const height = states ? 480 : Math.max(120, tallest * gap + 30);
  const places = states ? circle(graph.nodes.length, width, height) : grid(columns, left, height, graph.nodes.length);
  const most = Math.max(1e-9, ...graph.edges.map((edge) => Math.abs(edge.weight)));
  const svg = s('svg', { class: 'network', viewBox: `0 0 ${width} ${height}`, role: 'img',
    'aria-label': `network of ${graph.nodes.length} nodes and ${graph.edges.length} connections${parts > 1 ? ` in ${parts} parts` : ''}` });
  const lines = s('g');
  const drawn = [...graph.edges].reverse().map((edge) => { // the strongest on top
    const share = Math.abs(edge.weight) / most;
    const kind = edge.weight < 0 ? 'minus' : 'plus';
    const path = s('path', { d: way(places[edge.source], places[edge.target], edge.source === edge.target, states), class: kind, 'stroke-width': (0.4 + 3.6 * share).toFixed(2),
      'stroke-opacity': (0.15 + 0.8 * share).toFixed(2) });
    lines.append(path);
    return { edge, path };
  });
  svg.append(lines);
  graph.nodes.forEach((node, i) => {
    const [x, y] = places[i];
    const name = nameOf(node, sensors, actuators);
    const shape = node.kind === 'input' ? s('rect', { x: x - 8, y: y - 8, width: 16, height: 16, rx: 3, class: 'of-input' }) : s('circle', { cx: x, cy: y, r: node.kind === 'state' ? 15 : 9, class: `of-${node.kind}` });
    const text = node.kind === 'input' ? s('text', { x: x - 14, y: y + 4, 'text-anchor': 'end' }) : node.kind === 'output' ? s('text', { x: x + 14, y: y + 4 })
      : s('text', { x, y: node.kind === 'state' ? y + 4 : y - 13, 'text-anchor': 'middle' });
    text.textContent = node.kind === 'state' || node.kind === 'hidden' ? String(node.number + (node.kind === 'hidden' ? 1 : 0)) : name.length > 24 ? `${name.slice(0, 23)}…` : name;
    const group = s('g', { class: 'node', tabindex: 0, role: 'img', 'aria-label': `${name} ${node.text}` }, shape, text);
    const tell = () => {
      const own = drawn.filter(({ edge }) => edge.source === i || edge.target === i);
      for (const { path, edge } of drawn) path.classList.toggle('faint', edge.source !== i && edge.target !== i);
      const heard = own.filter(({ edge }) => edge.target === i).map(({ edge }) => `${nameOf(graph.nodes[edge.source], sensors, actuators)} ${edge.text || number(edge.weight, 3)}`).reverse();
      const told = own.filter(({ edge }) => edge.source === i && edge.target !== i).map(({ edge }) => `${nameOf(graph.nodes[edge.target], sensors, actuators)} ${edge.text || number(edge.weight, 3)}`).reverse();
      say([`${name}${parts > 1 ? ` of part ${node.part}` : ''}${node.text ? ` (${node.text})` : ''}`, heard.length ? `hears ${heard.slice(0, 12).join(', ')}` : '', told.length ? `leads to ${told.slice(0, 12).join(', ')}` : ''].filter(Boolean).join('; '));
    };
    const quiet = () => { for (const { path } of drawn) path.classList.remove('faint'); say(''); };
    group.addEventListener('pointerenter', tell);
    group.addEventListener('pointerleave', quiet);
    group.addEventListener('focus', tell);
    group.addEventListener('blur', quiet);
    svg.append(group);
  });
  return svg;
}

// Columns of nodes: inputs, hidden ones by how far they are from the inputs, outputs; parts below one another.
function layout(graph) {
  const depth = graph.nodes.map((node) => (node.kind === 'input' ? 0 : 1));
  const forward = graph.edges.filter((edge) => edge.source < edge.target && graph.nodes[edge.target].kind !== 'output' && graph.nodes[edge.source].kind === 'hidden');
  const back = new Set(graph.edges.filter((edge) => edge.source > edge.target).map((edge) => `${edge.target} ${edge.source}`));
  const layers = forward.filter((edge) => !back.has(`${edge.source} ${edge.target}`)); // who hears one another stands side by side
  for (let i = 0; i < Math.min(12, graph.nodes.length); i += 1) {
    for (const edge of layers) depth[edge.target] = Math.max(depth[edge.target], Math.min(6, depth[edge.source] + 1));
  }
  const hidden = depth.filter((_, i) => graph.nodes[i].kind === 'hidden');
  const last = Math.max(0, ...hidden) + 1;
  graph.nodes.forEach((node, i) => { if (node.kind === 'output') depth[i] = last; });
  const columns = Array.from({ length: last + 1 }, () => []);
  graph.nodes.forEach((node, i) => columns[depth[i]].push(i));
  return columns.filter((column) => column.length);
}

function grid(columns, left, height, count) {
  const places = Array.from({ length: count }, () => [0, 0]);
  columns.forEach((column, c) => column.forEach((node, r) => {
    places[node] = [left + 150 * c, (r + 0.5) * height / column.length];
  }));
  return places;
}

function circle(count, width, height) {
  const radius = Math.min(width, height) / 2 - 50;
  return Array.from({ length: count }, (_, i) => {
    const turn = 2 * Math.PI * i / count - Math.PI / 2;
    return [width / 2 + radius * Math.cos(turn), height / 2 + radius * Math.sin(turn)];
  });
}

function way([x1, y1], [x2, y2], itself, states) {
  if (itself) return `M ${x1 - 6} ${y1 - 7} C ${x1 - 30} ${y1 - 42}, ${x1 + 30} ${y1 - 42}, ${x1 + 6} ${y1 - 7}`;
  if (states) { // bent, so that there and back are two lines
    const [mx, my] = [(x1 + x2) / 2 + (y2 - y1) * 0.15, (y1 + y2) / 2 - (x2 - x1) * 0.15];
    return `M ${x1} ${y1} Q ${mx} ${my} ${x2} ${y2}`;
  }
  if (Math.abs(x1 - x2) < 1) return `M ${x1} ${y1} C ${x1 + 55} ${y1}, ${x2 + 55} ${y2}, ${x2} ${y2}`;
  const bend = x2 < x1 ? 60 : 0; // what leads back goes below
  return `M ${x1} ${y1} C ${(x1 + x2) / 2} ${y1 + bend}, ${(x1 + x2) / 2} ${y2 + bend}, ${x2} ${y2}`;
}
