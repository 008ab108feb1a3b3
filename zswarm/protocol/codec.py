"""Turn messages into bytes and back: msgpack, strictly.

Bytes that are not a valid message end in ``RemoteProtocolError``.
"""

import math
from collections.abc import Iterable
from typing import Any, TypeVar

import msgspec
import numpy as np
from msgspec import structs
from msgspec.msgpack import Decoder, Encoder

from zswarm.errors import RemoteProtocolError, UnknownMessageError
from zswarm.protocol import keys, messages, versions
from zswarm.protocol.messages import Evaluate, Fault, Outcomes, Running, Sensors
from zswarm.system.text import clean

M = TypeVar("M", bound=messages.Message)

MAX_DEPTH = 8  # of settings
UNKNOWN_REQUEST = 64 << 10  # bytes, of a request that a later program has
INVALID = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
# Fields whose texts are shown somewhere, by message; labels are checked by pattern instead.
_TEXTS = (
    messages.Text,
    messages.Names,
    messages.Limits,
    messages.Versions,
    messages.Part,
)
SHOWN: dict[type[msgspec.Struct], list[str]] = {
    kind: [field.name for field in structs.fields(kind) if field.type in _TEXTS]
    for kind in messages.Message.__subclasses__()
}
_TYPES = {kind.__struct_config__.tag for kind in SHOWN}
_encoder = Encoder()
_requests: Decoder[messages.Request] = Decoder(messages.Request)
_replies: Decoder[messages.Reply] = Decoder(messages.Reply)
_sensors = Decoder(Sensors)
_reactions: Decoder[messages.Reaction] = Decoder(messages.Reaction)


class _AnyMessage(msgspec.Struct):
    type: str


def encode(message: messages.Message) -> bytes:
    """Return a message as bytes."""
    return _encoder.encode(message)


def decode_request(body: bytes) -> messages.Request:
    """Return a message from an optimizer; its names are safe to show.

    Raises:
        UnknownMessageError: its type is unknown. So do the others.
        RemoteProtocolError: it is malformed or too large. So do the others.
    """
    message = _decode(body, _requests)
    if isinstance(message, messages.Requirements):
        _check_settings(message.settings)
    return message


def check_size(verb: str, size: int) -> None:
    """Refuse a request that has too many bytes for its verb; one that is unknown may be small."""
    if size > (limit := messages.MAX_REQUEST.get(verb, UNKNOWN_REQUEST)):
        text = f"a request to {verb} has {size:,} bytes; at most {limit:,} are taken"
        raise RemoteProtocolError(text)


def decode_query(key: str, body: bytes) -> tuple[keys.ServerKey, messages.Request]:
    """Return the parts of a server's key, and the message that was sent to it."""
    parts = keys.parse_server_key(key)
    check_size(parts.verb, len(body))
    message = decode_request(_adapted(parts.version, body))
    if parts.verb != messages.verb(message):
        raise RemoteProtocolError(f"a {type(message).__name__} was sent to {parts.verb}")
    return parts, message


def decode_reply(body: bytes) -> messages.Reply:
    """Return a message from a server; its texts are safe to show."""
    return _decode(body, _replies)


def decode_sensors(body: bytes) -> Sensors:
    """Return a server's question to an optimizer."""
    return _decode(body, _sensors)


def decode_reaction(body: bytes) -> messages.Reaction:
    """Return an optimizer's answer to ``Sensors``; its texts are safe to show."""
    return _decode(body, _reactions)


def _adapted(version: str, body: bytes) -> bytes:
    try:
        return versions.taken(version, body)
    except (*INVALID, KeyError, TypeError, ValueError) as error:
        text = f"not a message of {version}: {error!r}"
        raise RemoteProtocolError(clean(text)) from None


# ---- arrays; those that do not fit their message raise RemoteProtocolError


def sensed(
    message: Sensors, participants: int, inputs: int
) -> tuple[list[int], list[int], np.ndarray]:
    """Return agents, the participant of each, and observations: (agents, inputs) float32."""
    agents = array(message.agents, "<u4").tolist()
    owners = array(message.participants, "<u4").tolist()
    count = len(agents)
    if not agents or max(agents) >= messages.MAX_AGENTS:
        raise RemoteProtocolError(
            f"expected at least one agent, each below {messages.MAX_AGENTS}"
        )
    if len(owners) != count or max(owners) >= participants:
        raise RemoteProtocolError(
            f"{count} agents need as many participants, each below {participants}"
        )
    observations = _per_agent(message.observations, count, inputs, "inputs")
    if not np.isfinite(observations).all():
        raise RemoteProtocolError("an observation is not finite")
    return agents, owners, observations


def decided(message: messages.Actuators, agents: int, outputs: int) -> np.ndarray:
    """Return the actions, (agents, outputs) float32."""
    return _per_agent(message.actions, agents, outputs, "outputs")


def _per_agent(raw: bytes, agents: int, each: int, what: str) -> np.ndarray:
    numbers, expected = array(raw, "<f4"), agents * each
    if len(numbers) != expected:
        raise RemoteProtocolError(
            f"{agents} agents of {each} {what} need {expected} numbers, not {len(numbers)}"
        )
    return numbers.astype(np.float32).reshape(agents, each)


def trials(
    message: Evaluate, participants_per_trial: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the participants (trials, k) int64 and seeds (trials,) uint64 of a batch."""
    seeds, participants = array(message.seeds, "<u8"), array(message.participants, "<u4")
    count = len(seeds)
    if not 1 <= count <= messages.MAX_TRIALS:
        raise RemoteProtocolError(
            f"a batch holds 1 to {messages.MAX_TRIALS} trials, not {count}"
        )
    if len(participants) != count * participants_per_trial:
        raise RemoteProtocolError(
            f"{count} trials of {participants_per_trial} participants need"
            f" {count * participants_per_trial} indices, not {len(participants)}"
        )
    if participants.max() >= len(message.genomes):
        raise RemoteProtocolError(
            f"participant {participants.max()} is not among {len(message.genomes)} genomes"
        )
    return participants.astype(np.int64).reshape(count, participants_per_trial), seeds


def cut(message: Evaluate, first: int, end: int) -> Evaluate:
    """Return a batch of the trials ``first:end`` of a batch, with the genomes that they need."""
    count = len(message.seeds) // 8
    if (first, end) == (0, count):
        return message
    participants = np.frombuffer(message.participants, "<u4").reshape(count, -1)[
        first:end
    ]
    lowest, genomes = 0, 0
    if participants.size:
        lowest, genomes = int(participants.min()), int(participants.max()) + 1
    return structs.replace(
        message,
        genomes=message.genomes[lowest:genomes],
        participants=(participants - np.uint32(lowest)).astype("<u4").tobytes(),
        seeds=message.seeds[8 * first : 8 * end],
    )


def indices(numbers: Iterable[int]) -> bytes:
    """Return trials of a batch as they are sent."""
    return np.fromiter(numbers, "<u4").tobytes()


def outcomes(
    message: Outcomes | Running | Fault, count: int, participants: int, metrics: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the trials of a batch whose outcomes a message holds, and these outcomes.

    Args:
        count: trials of the batch.

    Returns:
        trials: (n,) indices into the batch, rising.
        fitness: (n, participants) float64.
        metrics: (n, metrics) float64.
    """
    if not message.trials and isinstance(message, Outcomes):
        trials = np.arange(count)
    else:
        trials = array(message.trials, "<u4").astype(np.int64)
        if len(trials) and (trials[-1] >= count or (trials[1:] <= trials[:-1]).any()):
            raise RemoteProtocolError(f"expected trials below {count}, in rising order")
    n = len(trials)
    fitness, measured = array(message.fitness, "<f8"), array(message.metrics, "<f8")
    if fitness.size != n * participants or measured.size != n * metrics:
        raise RemoteProtocolError(
            f"{n} trials need {n * participants} fitness numbers and {n * metrics} metrics,"
            f" not {fitness.size} and {measured.size}"
        )
    if np.isinf(fitness).any() or np.isinf(measured).any():
        raise RemoteProtocolError("an outcome is infinite")
    return trials, fitness.reshape(n, participants), measured.reshape(n, metrics)


def array(raw: bytes, dtype: str) -> np.ndarray:
    """Return raw little-endian numbers as an array."""
    if len(raw) % np.dtype(dtype).itemsize:
        raise RemoteProtocolError(f"{len(raw)} bytes are not a whole number of {dtype}")
    return np.frombuffer(raw, dtype)


# ---- decoding


def _decode(body: bytes, decoder: Decoder[M]) -> M:
    """Return a message with all texts that are shown made safe."""
    if len(body) > messages.MAX_MESSAGE:
        raise RemoteProtocolError(
            f"a message has {len(body)} bytes; at most {messages.MAX_MESSAGE} are taken"
        )
    try:
        message = decoder.decode(body)
    except INVALID as error:
        raise _refusal(body, error) from None
    names = SHOWN[type(message)]
    texts = {name: _clean(text) for name in names if (text := getattr(message, name))}
    return structs.replace(message, **texts) if texts else message


def _clean(value: Any) -> Any:
    match value:
        case str():
            return clean(value)
        case list():
            return [clean(text) for text in value]
        case messages.Part():
            _check_settings(value.settings)
            return messages.Part(clean(value.kind), value.settings)
    return {clean(name): clean(text) for name, text in value.items()}


def _refusal(body: bytes, error: Exception) -> RemoteProtocolError:
    try:
        kind = msgspec.msgpack.decode(body, type=_AnyMessage).type
    except INVALID:
        return RemoteProtocolError(f"not a message: {clean(str(error))}")
    if kind in _TYPES:
        return RemoteProtocolError(clean(str(error)))
    return UnknownMessageError(
        f"messages of type {clean(kind[:100])!r} are unknown here: the peer's zswarm is newer"
    )


def _check_settings(settings: dict[str, Any]) -> None:
    """Refuse settings but tables, lists, texts, finite numbers and booleans; too deep, too many."""
    level: list[Any] = [settings]
    count = 0
    for _ in range(MAX_DEPTH):
        inner: list[Any] = []
        for value in level:
            match value:
                case dict():
                    if not all(map(_is_key, value)):
                        text = "a key of settings is not a text, or too long"
                        raise RemoteProtocolError(text)
                    inner += value.values()
                case list():
                    inner += value
                case float() if not math.isfinite(value):
                    raise RemoteProtocolError("a setting is not finite")
                case float() | str() | int():
                    pass
                case _:
                    text = f"a setting is of type {type(value).__name__}"
                    raise RemoteProtocolError(text)
        count += len(inner)
        if count > messages.MAX_VALUES:
            raise RemoteProtocolError(
                f"settings have more than {messages.MAX_VALUES:,} values"
            )
        level = inner
    if level:
        raise RemoteProtocolError(f"settings are nested deeper than {MAX_DEPTH}")


def _is_key(key: object) -> bool:
    return isinstance(key, str) and len(key) <= messages.MAX_TEXT
