"""Studies inside one process: claims, losses and limits."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from optuna.storages.journal._storage import JournalOperation
from optuna.trial import FrozenTrial, TrialState

from pgdl_lab.core.errors import InputError, LabError
from pgdl_lab.search.postgresql import PostgresJournal
from pgdl_lab.search.settings import SearchSettings
from pgdl_lab.search.space import parse
from pgdl_lab.search.storage import open_storage
from pgdl_lab.search.study import SharedStudy
from pgdl_lab.search.tally import LOST, RETRY_OF
from tests import postgres
from tests.needs import need


def opened(folder: Path, typed: str = "x=interval(0,1)", config: Any = None, **fields: Any) -> SharedStudy:
    settings = SearchSettings("s", **{"n_trials": 4, "objectives": ["m"], **fields})
    return SharedStudy(
        folder, settings, open_storage(settings.storage, folder), parse({}, [typed]), config or {"seed": 0}
    )


def nothing(trial: FrozenTrial) -> None:
    return None


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    """URL of a PostgreSQL database, where a study goes by the name of its folder."""
    need("initdb")
    with postgres.server("fsync=off") as url:
        yield url


def test_workers_share_a_study_and_none_gets_more_than_is_left(tmp_path: Path) -> None:
    check_sharing(tmp_path, None)


def test_workers_share_a_study_in_postgresql(tmp_path: Path, database: str) -> None:
    check_sharing(tmp_path, database)
    assert not (tmp_path / "study.journal").exists()


def test_workers_share_a_study_in_the_tables_of_another_database(tmp_path: Path) -> None:
    check_sharing(tmp_path, f"sqlite:///{tmp_path}/study.db")
    assert not (tmp_path / "study.journal").exists()


def test_entries_in_postgresql_are_numbered_without_gaps_whoever_writes(database: str) -> None:
    def write(worker: int) -> None:
        journal = PostgresJournal(database, "many")
        for count in range(25):
            journal.append_logs([{"op_code": 0, "worker": worker, "count": count}])

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, range(4)))
    journal = PostgresJournal(database, "many")
    kept = journal.read_logs(0)
    assert sorted((log["worker"], log["count"]) for log in kept) == [(w, c) for w in range(4) for c in range(25)]
    assert all([log["count"] for log in kept if log["worker"] == worker] == list(range(25)) for worker in range(4))
    assert [journal.read_logs(start) for start in (40, 99, 100)] == [kept[40:], kept[99:], []]
    assert PostgresJournal(database, "another").read_logs(0) == []


def test_the_end_of_a_trial_is_on_the_disk(database: str) -> None:
    journal = PostgresJournal(database, "flushed")
    for _ in range(5):  # PostgreSQL flushes by itself five times a second
        journal.append_logs([{"op_code": JournalOperation.SET_TRIAL_STATE_VALUES, "values": [0.0] * 200}])
        asked = journal._open.execute("SELECT pg_current_wal_flush_lsn() >= pg_current_wal_insert_lsn()").fetchone()
        assert asked == (True,)


def test_a_connection_that_the_server_closed_is_opened_again(database: str) -> None:
    journal = PostgresJournal(database, "closed")
    journal.append_logs([{"op_code": 0}])
    pid = journal._open.info.backend_pid
    PostgresJournal(database, "other")._open.execute("SELECT pg_terminate_backend(%s, 5000)", (pid,))
    journal.append_logs([{"op_code": 1}])
    assert [log["op_code"] for log in journal.read_logs(0)] == [0, 1]


def test_a_database_that_does_not_answer_is_one_sentence(tmp_path: Path) -> None:
    url = f"postgresql+psycopg://lab:secret@/postgres?host={tmp_path}"
    with pytest.raises(InputError, match=r"storage=postgresql\+psycopg://lab:\*\*\*@/.* cannot be opened: connection"):
        open_storage(url, tmp_path)


def check_sharing(folder: Path, storage: str | None) -> None:
    one, two = opened(folder, storage=storage), opened(folder, storage=storage, batch=5)
    (first,) = one.claim(nothing)
    others = two.claim(nothing)
    assert [claim.trial.number for claim in others] == [1, 2, 3]
    assert one.claim(nothing) == []
    assert not one.complete
    for claim in others:
        two.tell(claim, [1.0])
    one.tell(first, None)
    assert one.complete and two.complete
    assert [trial.state.name for trial in one.trials()] == ["PRUNED", "COMPLETE", "COMPLETE", "COMPLETE"]
    assert len({trial.params["x"] for trial in one.trials()}) == 4  # workers do not draw the same


def test_what_a_killed_worker_ran_is_run_again_or_kept_if_it_had_ended(tmp_path: Path) -> None:
    killed, other = opened(tmp_path, batch=2), opened(tmp_path)
    lost, ended = killed.claim(nothing)
    killed._alive.release()  # what the kernel does
    (again,) = other.claim(lambda trial: [5.0] if trial.number == ended.trial.number else None)
    assert again.trial.user_attrs[RETRY_OF] == lost.trial.number
    assert again.trial.params == lost.trial.params
    states = [trial.state for trial in other.trials()]
    assert states == [TrialState.FAIL, TrialState.COMPLETE, TrialState.RUNNING]
    assert other.trials()[0].user_attrs[LOST]
    assert len(other.ended()) == 1


def test_a_trial_that_was_never_begun_is_dropped(tmp_path: Path) -> None:
    study = opened(tmp_path)
    study.study.ask()  # killed before it was given to a worker
    (claim,) = study.claim(nothing)
    assert claim.trial.number == 1
    assert study.ended() == []


def test_a_trial_that_was_lost_while_it_was_drawn_is_run_as_it_was_drawn(tmp_path: Path) -> None:
    study = opened(tmp_path, "x=interval(0,1)")
    study.study.enqueue_trial({"x": 0.25})
    study.study.ask()  # killed before x is read from the queue
    study.study.ask().suggest_float("x", 0, 1)  # killed before it was given to a worker
    drawn = study.trials()[1].params
    (first,), (second,) = study.claim(nothing), study.claim(nothing)
    assert first.trial.params == {"x": 0.25}
    assert second.trial.params == drawn
    assert [claim.trial.user_attrs[RETRY_OF] for claim in (first, second)] == [0, 1]
    assert study.ended() == []


@pytest.mark.parametrize(
    ("changes", "answer"),
    [
        ({"typed": "x=interval(0,2)"}, r"another space x: interval\(0,1\) there, interval\(0,2\) now"),
        ({"typed": "y=interval(0,1)"}, "another space x: .* there, none now"),
        ({"config": {"seed": 1}}, "another setting seed: 0 there, 1 now"),
        ({"objectives": ["k"]}, "another objective"),
    ],
)
def test_a_study_goes_on_only_as_it_was_begun(tmp_path: Path, changes: dict, answer: str) -> None:
    opened(tmp_path)
    if "objectives" in changes:
        answer += " k: none there, minimize now"
    with pytest.raises(InputError, match=answer):
        opened(tmp_path, **changes)
    opened(tmp_path, n_trials=9)


@pytest.mark.parametrize(
    ("fields", "answer"),
    [
        ({"sampler": {"_target_": "optuna.samplers.Nope"}}, "sampler cannot be made, .*: .* 'Nope' is importable"),
        ({"sampler": {"_target_": "optuna.samplers.TPESampler", "nope": 1}}, "sampler cannot be made, .*'nope'"),
        (
            {"pruner": {"_target_": "optuna.pruners.MedianPruner", "n_startup_trials": -1}},
            "pruner .*: Number of startup",
        ),
    ],
)
def test_a_sampler_or_pruner_that_cannot_be_made_is_one_sentence(tmp_path: Path, fields: dict, answer: str) -> None:
    with pytest.raises(InputError, match=answer):
        opened(tmp_path, **fields)


def test_a_study_stops_when_all_fail_or_too_many(tmp_path: Path) -> None:
    study = opened(tmp_path, n_trials=10, first_failures=2, max_failure_rate=0.2)
    for _ in range(2):
        study.tell(study.claim(nothing)[0], None, "The finger burst.")
    with pytest.raises(LabError, match=r"all of its first 2 trials failed, the last with: The finger burst\."):
        study.claim(nothing)
    mended = opened(tmp_path, n_trials=10, first_failures=2, max_failure_rate=0.2, retry_failed=True)
    for values in ([1.0], [1.0], None, None):
        mended.tell(mended.claim(nothing)[0], values, None if values else "Again.")
    mended.tell(mended.claim(nothing)[0], None, "Again.")
    with pytest.raises(LabError, match="3 of 5 trials failed, the last with: Again."):
        mended.claim(nothing)


def test_a_sampler_that_has_tried_all_ends_the_study(tmp_path: Path) -> None:
    sampler = {"_target_": "optuna.samplers.BruteForceSampler", "seed": 0}
    study = opened(tmp_path, "x=range(0,3)", n_trials=10, sampler=sampler)
    while claims := study.claim(nothing):
        study.tell(claims[0], [1.0])
    assert study.complete
    assert sorted(trial.params["x"] for trial in study.trials()) == [0, 1, 2]


def test_half_a_line_at_the_end_of_the_journal_is_dropped(tmp_path: Path) -> None:
    study = opened(tmp_path)
    study.tell(study.claim(nothing)[0], [1.0])
    with (tmp_path / "study.journal").open("ab") as file:
        file.write(b'{"op_code":4,"wor')  # what a machine leaves that fails as it writes
    again = opened(tmp_path)
    again.tell(again.claim(nothing)[0], [2.0])
    assert [trial.values for trial in opened(tmp_path).trials()] == [[1.0], [2.0]]


def test_trials_of_killed_workers_are_looked_for_when_nothing_else_is_left(tmp_path: Path) -> None:
    other, killed = opened(tmp_path, n_trials=3), opened(tmp_path, n_trials=3)
    (first,) = other.claim(nothing)
    (lost,) = killed.claim(nothing)
    killed._alive.release()  # what the kernel does
    (third,) = other.claim(nothing)
    assert third.trial.number == 2
    (again,) = other.claim(nothing)
    assert again.trial.params == lost.trial.params
    for claim in (first, third, again):
        other.tell(claim, [1.0])
    assert other.claim(nothing) == [] and other.complete


def test_the_tally_of_what_is_new_is_that_of_all(tmp_path: Path) -> None:
    fields = {"n_trials": 9, "first_failures": 9, "max_failure_rate": 1.0}
    study, watcher = opened(tmp_path, **fields), opened(tmp_path, **fields)
    for values in ([1.0], None, [2.0]):
        study.tell(study.claim(nothing)[0], values, None if values else "The finger burst.")
        watcher.ended()
    assert [trial.number for trial in watcher.ended()] == [0, 1, 2]
    mended = opened(tmp_path, retry_failed=True, **fields)
    for each in (study, watcher, mended, opened(tmp_path, **fields)):
        assert sorted(trial.number for trial in each.ended()) == [0, 2]
        assert each.failed() == []
    (again,) = watcher.claim(nothing)
    assert again.trial.user_attrs[RETRY_OF] == 1
