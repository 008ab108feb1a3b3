"""Pack an optimizer's state: genomes by where they are recorded, and long values in pieces.

SQLite takes at most 1e9 bytes in a value, MessagePack 4 GiB; a state may have more.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

PIECE = 4 << 20  # bytes
GENOME, LONG = 1, 2  # MessagePack's extension types

Place = tuple[int, int]  # generation and candidate


class PackedState(NamedTuple):
    """A state as it is recorded.

    Attributes:
        parts: MessagePack of the state, and the long values that it refers to by number.
        genomes: recorded ones that it refers to.
    """

    parts: Sequence[bytes]
    genomes: Mapping[bytes, Place]

    def pieces(self) -> list[tuple[int, int, memoryview]]:
        """Return part, number and bytes of each piece."""
        return [
            (part, begin // PIECE, memoryview(body)[begin : begin + PIECE])
            for part, body in enumerate(self.parts)
            for begin in range(0, len(body), PIECE)
        ]


def pack(state: Any, known: Mapping[bytes, Place]) -> PackedState:
    """Pack a state of plain values.

    Args:
        known: where genomes are recorded.
    """
    parts, genomes = [b""], {}

    def packed(value: Any) -> Any:
        if isinstance(value, bytes):
            place = known.get(value)
            if place is not None:
                genomes[value] = place
                return msgspec.msgpack.Ext(GENOME, msgspec.msgpack.encode(place))
            if len(value) > PIECE:
                parts.append(value)
                number = len(parts) - 1
                return msgspec.msgpack.Ext(LONG, msgspec.msgpack.encode(number))
        elif isinstance(value, dict):
            return {key: packed(item) for key, item in value.items()}
        elif isinstance(value, list | tuple):
            return [packed(item) for item in value]
        return value

    parts[0] = msgspec.msgpack.encode(packed(state))
    return PackedState(parts, genomes)


def unpack(
    pieces: Sequence[tuple[int, bytes]], genome: Callable[[Place], bytes]
) -> tuple[Any, dict[bytes, Place]]:
    """Return a state, and where the genomes are recorded that it refers to.

    Args:
        pieces: part and bytes of each, in order.
        genome: returns a recorded genome.

    Raises:
        msgspec.DecodeError, LookupError, TypeError, ValueError: it is damaged.
    """
    parts: dict[int, list[bytes]] = {}
    genomes: dict[bytes, Place] = {}
    for part, body in pieces:
        parts.setdefault(part, []).append(body)

    def unpacked(code: int, body: memoryview) -> Any:
        if code == LONG:
            return b"".join(parts[msgspec.msgpack.decode(body, type=int)])
        place = msgspec.msgpack.decode(body, type=Place)
        found = genome(place)
        genomes[found] = place
        return found

    decoder = msgspec.msgpack.Decoder(ext_hook=unpacked)
    return decoder.decode(b"".join(parts[0])), genomes
