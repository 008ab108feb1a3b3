// The bytes of a trace (docs/replay.md).

const MAGIC = "zswtrace", VERSION = 1;

/** Return the header of a trace, with its tables as `tracks`. */
export async function decode(given) {
  const bytes = new Uint8Array(given), view = new DataView(bytes.buffer), text = new TextDecoder();
  if (bytes.length < 16 || text.decode(bytes.subarray(0, 8)) !== MAGIC) throw new Error("no trace");
  const version = view.getUint32(8, true), end = 16 + view.getUint32(12, true);
  if (version !== VERSION) throw new Error(`a trace of version ${version}, expected ${VERSION}`);
  const header = JSON.parse(text.decode(bytes.subarray(16, end)));
  const unzip = new DecompressionStream("deflate");
  const stream = new Blob([bytes.subarray(end)]).stream().pipeThrough(unzip);
  const packed = new Uint8Array(await new Response(stream).arrayBuffer());
  const tracks = {};
  let at = 0;
  for (const track of header.tracks) {
    tracks[track.name] = { ...track, values: unpack(packed, at, track) };
    at += track.rows * track.columns * track.bytes;
  }
  if (at !== packed.length) throw new Error("a trace whose tables do not fit");
  return { ...header, tracks };
}

/** Return a table, row by row, from differences in each column; values wrap around. */
function unpack(packed, at, { rows, columns, bytes }) {
  const count = rows * columns,
    values = bytes === 2 ? new Uint16Array(count) : new Uint8Array(count);
  for (let place = 0; place < count; place += 1) {
    const row = place % rows, to = row * columns + Math.floor(place / rows);
    const [high, low] = bytes === 2 ? [packed[at + place], packed[at + place + count]]
      : [0, packed[at + place]];
    values[to] = (row ? values[to - columns] : 0) + 256 * high + low;
  }
  return values;
}
