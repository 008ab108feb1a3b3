"""A run: ask, dispatch, tell, record, until the last generation."""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager

import msgspec
from msgspec import structs

from zswarm.champion.held_out import HeldOut
from zswarm.config.decode import to_json
from zswarm.config.sections import StopConfig
from zswarm.ot.assessment import amount, contest
from zswarm.ot.assessment.contest import Contest
from zswarm.ot.assessment.seen_seeds import SeenSeeds
from zswarm.ot.assessment.track import Track
from zswarm.ot.build import Parts
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.cluster.events import Counted, Retracted
from zswarm.ot.cluster.machines import Known
from zswarm.ot.cluster.matching import RunProgram
from zswarm.ot.cluster.shell import Cluster, Item
from zswarm.ot.generation import Assessment, assess
from zswarm.ot.identity import here
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.notes import Note, RunEvent, words
from zswarm.ot.record import stopping
from zswarm.ot.record.history_hash import VERSION as HISTORY_VERSION
from zswarm.ot.record.packing import PackedState
from zswarm.ot.record.retelling import retell, timed
from zswarm.ot.record.schema import ASSESSMENT
from zswarm.ot.record.stopping import Spent, StopWatch
from zswarm.ot.record.writer import Record
from zswarm.ot.workload import Workload
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import messages


def evolve(
    parts: Parts,
    record: Record,
    connection: Connection,
    logger: Logger,
    stop: threading.Event,
    obey: Callable[[Cluster], None] = lambda _: None,
) -> Generator[Generation, None, Result]:
    """Evolve from where the record ends to the last generation; yield each one when it ended.

    Servers have the next generation by then: they evaluate it while the caller looks at this one.

    Closing the generator ends the run within a moment, as setting ``stop`` does. ``obey`` is called
    between two generations, and may wait or raise ``Stopped``.

    Raises:
        EvaluationError: trials cannot be evaluated.
        NoServers: too few servers were found in time.
        Stopped: ``stop`` was set.
    """
    begin, (problem, optimizer) = time.monotonic(), parts
    notebook = _Notebook(parts, record, logger)
    first = notebook.resume(connection)
    last = first if notebook.why else problem.experiment.generations
    with notebook.leased(connection, stop) as cluster:
        for early in connection.wait(cluster):
            notebook.take(early)
        if first < last:
            assessment = notebook.begin(first)
            items = cluster.evaluate(assessment.workload)
        for generation in range(first, last):
            notebook.follow(items, assessment.workload)
            while assessment.advance():
                record.begin(generation, assessment.workload)
                if generation == first:
                    record.restore(assessment.workload)
                items = cluster.evaluate(assessment.workload)
                notebook.follow(items, assessment.workload)
            ended = assessment
            state = notebook.tell(ended)
            more = generation + 1 < last and not notebook.ends(ended)
            if more:
                # Servers have work while this generation is recorded.
                assessment = assess(problem, optimizer, generation + 1)
                items = cluster.evaluate(assessment.workload)
            yield notebook.finish(ended, state, cluster)
            obey(cluster)
            if not more:
                break
            record.begin(generation + 1, assessment.workload)
        notebook.end(cluster, obey)
    return notebook.result(time.monotonic() - begin)


class _Notebook:
    """Records and logs a run, and knows its numbers so far."""

    def __init__(self, parts: Parts, record: Record, logger: Logger) -> None:
        self._problem, self._optimizer = parts
        self._record, self._logger = record, logger
        record.say = logger.on_say
        self._held_out: HeldOut | None = None  # fitness of the champion
        self._hash = ""  # of the assessment
        self._differ: bool | None = None  # do trials of a candidate?
        self._whole = 0  # trials of the assessment, once it begins
        self.why = ""  # the run ends before its last generation
        self._since = time.monotonic()  # the last generation ended, or the program began
        self.run_id: str = record.meta("run_id")
        self.probe: bytes = record.meta("probe") or b""

    def known(self) -> Known:
        """Return what earlier programs of the run found out about machines.

        Their verdict on the probe counts while the same code computes.
        """
        known, record = self._record.known(), self._record
        digest = record.meta("arbitrated")
        if isinstance(digest, bytes) and record.meta("arbitrated_by") == self._code():
            return structs.replace(known, arbitrated=digest)
        return known

    def resume(self, connection: Connection) -> int:
        """Restore the optimizer, log how the run begins, and return its first generation."""
        record, optimizer, say = self._record, self._optimizer, self._logger.on_say
        complete, resumed = self._problem.experiment, record.resumed()
        told = timed(record.told(), resumed.generation, say)
        if resumed.state is not None:
            optimizer.restore(resumed.state, told)
        elif optimizer.replays:
            optimizer.restore({"generation": resumed.generation}, told)
        else:
            retell(optimizer, told, record.digests)
        if resumed.generation and optimizer.best()[0]:
            self._keep_champion()  # the program may have ended before it was written
        self._improved = optimizer.best()[1]
        if optimizer.fresh:
            self._seen = SeenSeeds.of_record(record)
        self._candidates, self._ended = record.evaluations(), resumed.generation
        stop, trials = complete.stop, complete.problem.trials
        self._watch = StopWatch(
            stop, trials, record.spent() if stop != StopConfig() else ()
        )
        self.why = self._watch.reason()
        now = here(complete, resumed.generation)
        record.note(Note(RunEvent.BEGAN, text=now.text, count=record.meta("epoch")))
        self._logger.on_start(Started(record.folder, complete, resumed.generation))
        say(f"{complete.name}: {connection.who_computes()}")
        if not self._problem.simulator.repeatable:
            record.set_meta("repeatable", 0)
            say(
                f"{complete.problem.simulator} is not repeatable with these settings: another run "
                "gives other results"
            )
        if (options := connection.options).controller == "optimizer":
            say(
                "the controllers stay in this program: servers ask it a question for each "
                f"{options.messages}"
            )
        if optimizer.diverged is not None:
            say(
                f"{complete.optimizer.kind} would have proposed other candidates from generation "
                f"{optimizer.diverged + 1} on; it continues from the recorded ones"
            )
        return resumed.generation

    def begin(self, generation: int) -> Assessment:
        """Ask for the first generation, and restore what is recorded of it."""
        record, optimizer = self._record, self._optimizer
        assessment = assess(self._problem, optimizer, generation)
        record.begin(generation, assessment.workload)
        if not optimizer.portable and (others := record.forget_others()):
            self._logger.on_say(
                f"generation {generation + 1} was begun with other candidates: {others} trials are "
                "dropped"
            )
        record.restore(assessment.workload)
        return assessment

    def follow(self, items: Iterator[Item | None], work: Workload) -> None:
        """Record what happens until a round of games is evaluated."""
        for item in items:
            self.take(item, work)
            counted = work.first + int(work.counted.sum())
            trials = max(work.first + len(work.seeds), self._whole)
            self._logger.on_progress(work.generation, counted, trials)

    def take(self, item: Item | None, work: Workload | None = None) -> None:
        """Record what happened; outcomes are of this workload."""
        match item:
            case Counted() if work is not None:
                self._record.add(item, work)
            case Retracted():
                self._record.retract(item.server)
            case Note():
                self._record.note(item)
                if item.event == RunEvent.PROBE_ARBITRATED:
                    self._arbitrated(bytes.fromhex(item.text))
                self._logger.on_event(item)
                if line := words(item):
                    self._logger.on_say(line)
            case None:
                self._record.check()

    def leased(
        self, connection: Connection, stop: threading.Event
    ) -> AbstractContextManager[Cluster]:
        """Ask for the slots that evaluate the run."""
        problem, optimizer, record = self._problem, self._optimizer, self._record
        return connection.cluster(
            problem,
            run=self.run_id,
            program=RunProgram(record.meta("epoch"), record.meta("secret")),
            slots=problem.trials_at_once(optimizer.candidates) or messages.MAX_SLOTS,
            probe=self.probe,
            known=self.known(),
            say=self._logger.on_say,
            wait=self._logger.on_wait,
            stop=stop,
            taken_over=record.taken_over,
        )

    def ends(self, ended: Assessment) -> bool:
        """Return whether the run ends after a generation that was told."""
        before, self._since = self._since, time.monotonic()
        spent = Spent(
            self._optimizer.best()[1],
            len(ended.genomes),
            ended.trials,
            self._since - before,
        )
        self._watch.take(spent)
        self.why = self._watch.reason()
        return bool(self.why)

    def _arbitrated(self, digest: bytes) -> None:
        """Record what this machine computed of the probe: a resume does not decide again."""
        self.probe = digest
        self._record.set_meta("probe", digest)
        self._record.set_meta("arbitrated", digest)
        self._record.set_meta("arbitrated_by", self._code())

    def _code(self) -> str:
        complete = self._problem.experiment
        return version_hash(complete.problem.simulator, complete.representation.kind)

    def tell(self, ended: Assessment) -> PackedState:
        """Tell the optimizer a generation, and return its state before the next ask."""
        self._fitness, self._measures = (
            ended.fitness(),
            ended.measures(self._optimizer.measures),
        )
        if self._optimizer.fresh:
            told = self._seen.merge(ended.genomes, self._fitness, self._measures)
            self._fitness, self._measures = told
        self._optimizer.tell(self._fitness, self._measures)
        state = self._optimizer.state()
        return self._record.pack(ended.generation, ended.genomes, state)

    def finish(
        self, ended: Assessment, state: PackedState, cluster: Cluster
    ) -> Generation:
        """Record a generation, and its champion if it is a better one."""
        record, optimizer, standing = self._record, self._optimizer, cluster.standing
        genomes, fitness, measures = ended.genomes, self._fitness, self._measures
        statistics = optimizer.statistics()
        record.finish(ended.generation, genomes, fitness, statistics, state, measures)
        genome, best = optimizer.best()
        # Scores of two generations do not compare, and fresh seeds may show that the former best
        # was lucky: the latest champion counts.
        outdated = optimizer.fresh and best != self._improved
        if best > self._improved or (genome and (optimizer.relative or outdated)):
            self._improved = best
            self._keep_champion(log=True)
        if standing.probe not in (b"", self.probe):  # or it was wrong, or of fewer trials
            self.probe = standing.probe
            record.set_meta("probe", self.probe)
        self._candidates, self._ended = (
            self._candidates + len(genomes),
            ended.generation + 1,
        )
        generation = Generation(
            ended.generation,
            statistics["best"],
            statistics["mean"],
            self._candidates,
            standing.serving,
            standing.slots,
            statistics,
            *self._expected(ended),
            self._problem.fitness_trials,
        )
        self._logger.on_generation(generation)
        if self.why:
            stop = self._problem.experiment.stop
            record.set_meta(stopping.STOPPED, stopping.entry(stop, self.why))
            self._logger.on_say(f"ends after generation {self._ended}: {self.why}")
        return generation

    def _expected(self, ended: Assessment) -> tuple[int, float]:
        """Return generations and the share of the assessment, as a generation lets expect."""
        complete, left = self._problem.experiment, self._watch.generations_left()
        last = complete.generations
        if left is not None:
            last = min(last, self._ended + left)
        if self._differ is None:
            self._differ = ended.differ()
        fit = self._differ and contest.unfit(self._problem) == ""
        searched = max(1, last * ended.trials)
        return last, amount.trials_after(complete, searched, last, fit=fit) / searched

    def end(self, cluster: Cluster, obey: Callable[[Cluster], None]) -> None:
        """Assess the candidates of the run, if there is something to assess; take what is late."""
        problem, record = self._problem, self._record
        race = Contest.of_run(problem, record)
        track = Track.of_run(problem, record)
        if race is not None or track is not None:
            plan = race.plan if race is not None else ""
            record.begin_assessment(f"{plan}{problem.experiment.assessment.track or ''}")
            self._whole = (race.budget if race else 0) + (track.trials if track else 0)
        if race is not None:
            self._assess(race, cluster, obey)
        if track is not None:
            rounds = (race.round, race.first) if race is not None else (0, 0)
            work = track.workload(*rounds)
            self._play(work, cluster)
            record.set_meta("track", msgspec.json.encode(track.result(work)).decode())
        self._record.end()
        for late in cluster.rest():
            self.take(late)

    def _assess(
        self, race: Contest, cluster: Cluster, obey: Callable[[Cluster], None]
    ) -> None:
        """Race the best candidates on held-out seeds; the winner becomes the champion."""
        record, problem = self._record, self._problem
        while (work := race.workload()) is not None:
            self._play(work, cluster)
            race.take(work)
            obey(cluster)
        if (found := race.champion()) is None:
            return
        genome, self._held_out = found
        self._hash = race.hash(record.history().value)
        champion = problem.controller(genome, self._held_out.in_search, self.run_id)
        champion = structs.replace(champion, held_out=self._held_out)
        record.champion(champion)
        record.set_meta("assessment", to_json(structs.asdict(self._held_out)))
        record.set_meta("assessment_hash", self._hash)
        self._logger.on_champion(champion)

    def _play(self, work: Workload, cluster: Cluster) -> None:
        """Play a round of the assessment, but for what is recorded of it."""
        self._record.begin(ASSESSMENT, work)
        self._record.restore(work)
        self.follow(cluster.evaluate(work), work)

    def result(self, seconds: float) -> Result:
        """Record the end of the run."""
        record, history = self._record, self._record.history().hex()
        record.set_meta("history_hash", history)
        record.sync()
        return Result(
            run=str(record.folder),
            generations=self._ended,
            best=self._optimizer.best()[1],
            evaluations=self._candidates,
            history_hash=history,
            seconds=round(seconds, 3),
            relative=self._optimizer.relative,
            champion=self._held_out,
            assessment_hash=self._hash,
            history_version=HISTORY_VERSION,
            repeatable=self._problem.simulator.repeatable,
            trials=self._problem.fitness_trials,
            **record.counts(),
        )

    def _keep_champion(self, *, log: bool = False) -> None:
        champion = self._problem.controller(*self._optimizer.best(), self.run_id)
        self._record.champion(champion)
        if log:
            self._logger.on_champion(champion)
