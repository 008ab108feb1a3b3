"""Messages to bytes and back: msgpack, strictly. Whatever does not fit ends in ``RemoteProtocolError``."""

import math
import unicodedata
from collections.abc import Iterable
from typing import Any, TypeVar

import msgspec
import numpy as np

from zswarm.errors import RemoteProtocolError
from zswarm.protocol import keys, messages
from zswarm.protocol.messages import (
    MAX_AGENTS,
    MAX_MESSAGE,
    MAX_TEXT,
    MAX_TRIALS,
    Actuators,
    Message,
    Reaction,
    Refused,
    Reply,
    Request,
    Sensors,
)

T = TypeVar("T")

MAX_DEPTH = 8  # of settings
UNSAFE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}  # Unicode categories: controls, formats, line separators, unassigned
_encoder = msgspec.msgpack.Encoder()
_requests: msgspec.msgpack.Decoder[Request] = msgspec.msgpack.Decoder(Request)
_replies: msgspec.msgpack.Decoder[Reply] = msgspec.msgpack.Decoder(Reply)
_sensors: msgspec.msgpack.Decoder[Sensors] = msgspec.msgpack.Decoder(Sensors)
_reactions: msgspec.msgpack.Decoder[Reaction] = msgspec.msgpack.Decoder(Reaction)


class _Version(msgspec.Struct):
    v: int


_version = msgspec.msgpack.Decoder(_Version)


def encode(message: Message) -> bytes:
    """A message as bytes."""
    return _encoder.encode(message)


def decode_request(body: bytes) -> Request:
    """A message from an optimizer; its names are safe to show.

    Raises:
        RemoteProtocolError: malformed, too large, of another version, or holding what no message may hold.
    """
    message = _decode(body, _requests)
    match message:
        case messages.Requirements():
            texts = {name: clean(getattr(message, name)) for name in ("simulator", "representation", "version_hash")}
            _check_plain(message.settings, MAX_DEPTH)
            versions = {clean(name): clean(version) for name, version in message.versions.items()}
            return msgspec.structs.replace(message, **texts, versions=versions)
        case messages.Reserve():
            parts = {name: _part(getattr(message, name)) for name in ("simulator", "representation")}
            return msgspec.structs.replace(message, **parts, version_hash=clean(message.version_hash))
    return message


def decode_query(key: str, body: bytes) -> tuple[keys.ServerKey, Request]:
    """What came to a server under a key: the key's parts, and the message.

    Raises:
        RemoteProtocolError: as ``decode_request``, or the key is none of a server's or another message's.
    """
    parts = keys.parse_server_key(key)
    message = decode_request(body)
    verb = "offer" if isinstance(message, messages.Requirements) else type(message).__name__.lower()
    if parts.verb != verb:
        raise RemoteProtocolError(f"a {type(message).__name__} was sent to {parts.verb}")
    return parts, message


def decode_reply(body: bytes) -> Reply:
    """A message from a server; its texts are safe to show.

    Raises:
        RemoteProtocolError: as ``decode_request``.
    """
    message = _decode(body, _replies)
    match message:
        case messages.Offer():
            lists = {
                name: [clean(text) for text in getattr(message, name)] for name in ("simulators", "representations", "limits")
            }
            texts = {name: clean(getattr(message, name)) for name in ("server", "program", "machine", "mismatch")}
            return msgspec.structs.replace(message, **lists, **texts)
        case messages.Lease() | messages.Refused():
            return msgspec.structs.replace(message, reason=clean(message.reason))
        case messages.Fault():
            return msgspec.structs.replace(message, reason=clean(message.reason), error=clean(message.error))
        case messages.Outcomes() | messages.Running() if message.error:
            return msgspec.structs.replace(message, error=clean(message.error))
    return message


def decode_sensors(body: bytes) -> Sensors:
    """What a server asks an optimizer.

    Raises:
        RemoteProtocolError: as ``decode_request``.
    """
    return _decode(body, _sensors)


def decode_reaction(body: bytes) -> Reaction:
    """What an optimizer answers to ``Sensors``; its texts are safe to show.

    Raises:
        RemoteProtocolError: as ``decode_request``.
    """
    message = _decode(body, _reactions)
    if isinstance(message, Refused):
        return msgspec.structs.replace(message, reason=clean(message.reason))
    return message


def sensed(message: Sensors, participants: int, inputs: int) -> tuple[list[int], list[int], np.ndarray]:
    """Agents, the participant of each, and what they observe: (agents, inputs) float32, a copy.

    Raises:
        RemoteProtocolError: the arrays do not fit together, a number is not finite, or there is no such participant or agent.
    """
    agents, owners = array(message.agents, "<u4").tolist(), array(message.participants, "<u4").tolist()
    observations = array(message.observations, "<f4")
    if not agents or max(agents) >= MAX_AGENTS:
        raise RemoteProtocolError(f"sensors are those of one agent at least, each below {MAX_AGENTS}")
    if len(owners) != len(agents) or max(owners) >= participants:
        raise RemoteProtocolError(f"{len(agents)} agents need as many participants, each below {participants}")
    if len(observations) != len(agents) * inputs:
        raise RemoteProtocolError(
            f"{len(agents)} agents of {inputs} inputs need {len(agents) * inputs} numbers, not {len(observations)}"
        )
    if not np.isfinite(observations).all():
        raise RemoteProtocolError("an observation is not finite")
    return agents, owners, observations.astype(np.float32).reshape(len(agents), inputs)


def decided(message: Actuators, agents: int, outputs: int) -> np.ndarray:
    """(agents, outputs) float32.

    Raises:
        RemoteProtocolError: it is of another size.
    """
    actions = array(message.actions, "<f4")
    if len(actions) != agents * outputs:
        raise RemoteProtocolError(f"{agents} agents of {outputs} outputs need {agents * outputs} numbers, not {len(actions)}")
    return actions.astype(np.float32).reshape(agents, outputs)


def trials(message: messages.Evaluate, participants_per_trial: int) -> tuple[np.ndarray, np.ndarray]:
    """Participants (trials, k) int64 and seeds (trials,) uint64 of a batch.

    Raises:
        RemoteProtocolError: the arrays do not fit together, or a participant is not among the genomes.
    """
    seeds = array(message.seeds, "<u8")
    if not 1 <= len(seeds) <= MAX_TRIALS:
        raise RemoteProtocolError(f"a batch holds 1 to {MAX_TRIALS} trials, not {len(seeds)}")
    participants = array(message.participants, "<u4")
    if len(participants) != len(seeds) * participants_per_trial:
        raise RemoteProtocolError(
            f"{len(seeds)} trials of {participants_per_trial} participants need {len(seeds) * participants_per_trial} "
            f"indices, not {len(participants)}"
        )
    if participants.max() >= len(message.genomes):
        raise RemoteProtocolError(f"participant {participants.max()} is not among {len(message.genomes)} genomes")
    return participants.astype(np.int64).reshape(len(seeds), participants_per_trial), seeds


def cut(message: messages.Evaluate, first: int, end: int) -> messages.Evaluate:
    """A batch of some trials of a batch, from first to before end, with the genomes that they need."""
    count = len(message.seeds) // 8
    if (first, end) == (0, count):
        return message
    participants = np.frombuffer(message.participants, "<u4").reshape(count, -1)[first:end]
    lowest, highest = (int(participants.min()), int(participants.max())) if participants.size else (0, -1)
    return messages.Evaluate(
        lease=message.lease,
        batch=message.batch,
        genomes=message.genomes[lowest : highest + 1],
        participants=(participants - np.uint32(lowest)).astype("<u4").tobytes(),
        seeds=message.seeds[8 * first : 8 * end],
    )


def indices(numbers: Iterable[int]) -> bytes:
    """Trials of a batch, as they are sent."""
    return np.fromiter(numbers, "<u4").tobytes()


def outcomes(
    message: messages.Outcomes | messages.Running | messages.Fault, count: int, participants: int, metrics: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trials (told,) as indices into the batch, their fitness (told, participants) and metrics (told, metrics), float64.

    Raises:
        RemoteProtocolError: wrong sizes, no trial of the batch or one twice, or an infinite number.
    """
    if not message.trials and isinstance(message, messages.Outcomes):
        trials = np.arange(count)
    else:
        trials = array(message.trials, "<u4").astype(np.int64)
        if len(trials) and (trials[-1] >= count or (trials[1:] <= trials[:-1]).any()):
            raise RemoteProtocolError(f"trials of a batch of {count} are told in rising order, each once")
    told = len(trials)
    fitness, measured = array(message.fitness, "<f8"), array(message.metrics, "<f8")
    if fitness.size != told * participants or measured.size != told * metrics:
        raise RemoteProtocolError(
            f"{told} trials need {told * participants} fitness numbers and {told * metrics} metrics, "
            f"not {fitness.size} and {measured.size}"
        )
    if np.isinf(fitness).any() or np.isinf(measured).any():
        raise RemoteProtocolError("an outcome is infinite")
    return trials, fitness.reshape(told, participants), measured.reshape(told, metrics)


def array(raw: bytes, dtype: str) -> np.ndarray:
    """Raw little-endian numbers.

    Raises:
        RemoteProtocolError: the length is no multiple of a number's.
    """
    if len(raw) % np.dtype(dtype).itemsize:
        raise RemoteProtocolError(f"{len(raw)} bytes are no whole number of {dtype}")
    return np.frombuffer(raw, dtype)


def clean(text: str) -> str:
    """A text from elsewhere, safe for a terminal, a log and a page: no control or format characters, bounded."""
    if text.isascii() and text.isprintable():
        return text[:MAX_TEXT]
    return "".join(
        character if unicodedata.category(character) not in UNSAFE else f"\\x{ord(character):02x}" for character in text
    )[:MAX_TEXT]


def _decode(body: bytes, decoder: msgspec.msgpack.Decoder[T]) -> T:
    if len(body) > MAX_MESSAGE:
        raise RemoteProtocolError(f"a message has {len(body)} bytes; at most {MAX_MESSAGE} are taken")
    try:
        return decoder.decode(body)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RemoteProtocolError(_explain(body, error)) from None


def _explain(body: bytes, error: Exception) -> str:
    try:
        version = _version.decode(body).v
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return f"not a message: {clean(str(error))}"
    if version != keys.VERSION:
        return f"the peer speaks version {version} of the protocol, this program version {keys.VERSION}"
    return clean(str(error))


def _part(part: messages.Part) -> messages.Part:
    _check_plain(part.settings, MAX_DEPTH)
    return messages.Part(clean(part.kind), part.settings)


def _check_plain(value: Any, depth: int) -> None:
    """Settings are tables, lists, texts, finite numbers and truth values, not nested too deep."""
    if depth == 0:
        raise RemoteProtocolError(f"settings are nested deeper than {MAX_DEPTH}")
    if isinstance(value, dict):
        for key, item in value.items():
            if not isinstance(key, str) or len(key) > MAX_TEXT:
                raise RemoteProtocolError("a settings' key is no text, or too long")
            _check_plain(item, depth - 1)
    elif isinstance(value, list):
        for item in value:
            _check_plain(item, depth - 1)
    elif isinstance(value, float):
        if not math.isfinite(value):
            raise RemoteProtocolError("a setting is not finite")
    elif not isinstance(value, (str, int)):
        raise RemoteProtocolError(f"a setting is of no known type: {type(value).__name__}")
