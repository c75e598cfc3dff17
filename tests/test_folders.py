import threading
from pathlib import Path

import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.running import folders


def test_new_folders_differ_even_within_a_second(root: Path) -> None:
    names = {folders.run_folder(None, None) for _ in range(50)}
    assert len(names) == 50
    assert {Path(name).parent for name in names} == {root / "runs"}


def test_a_stored_run_is_found_from_the_root_and_from_elsewhere(
    root: Path, monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    run = root / "runs" / "one"
    run.mkdir()
    (run / "config.yaml").touch()
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    folders._link(folders.LATEST, run)
    for name in ("runs/one", "runs/latest", str(run)):
        assert folders.run_folder(name, None) == str(run)


def test_a_folder_without_a_run_is_refused(root: Path) -> None:
    with pytest.raises(InputError, match="There is no run in 'runs'"):
        folders.run_folder("runs", None)


def test_an_unwritable_folder_is_refused(root: Path) -> None:
    (root / "runs").rmdir()
    (root / "runs").touch()
    with pytest.raises(InputError, match=r"Nothing can be written to .*/runs .*PGDL_LAB_ROOT"):
        folders.run_folder(None, None)


def test_the_link_is_never_missing_while_runs_start(root: Path) -> None:
    runs = [root / "runs" / str(index) for index in range(4)]
    for run in runs:
        run.mkdir()
    latest = root / "runs" / "latest"
    folders._link(folders.LATEST, runs[0])
    seen = []

    def start(run: Path) -> None:
        for _ in range(50):
            folders._link(folders.LATEST, run)
            seen.append(latest.resolve() in runs)

    threads = [threading.Thread(target=start, args=[run]) for run in runs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 200
    assert all(seen)
    assert {path.name for path in (root / "runs").iterdir()} == {"0", "1", "2", "3", "latest"}


def test_only_what_came_to_its_end_with_a_surrogate_is_the_latest(root: Path) -> None:
    runs = root / "runs"
    latest, unfinished = runs / folders.LATEST, runs / folders.UNFINISHED

    def run(name: str, *made: str) -> Path:
        (runs / name).mkdir()
        for file in ("config.yaml", "run.log", *made):
            (runs / name / file).touch()
        folders.begin(runs / name)
        assert unfinished.resolve() == runs / name
        return runs / name

    whole = run("trained", "surrogate.pt", "metrics.json")
    folders.end(whole)
    assert latest.resolve() == whole and not unfinished.is_symlink()
    folders.end(run("simulated", "metrics.json"))
    assert latest.resolve() == whole and not unfinished.is_symlink()
    burst = run("burst")
    assert latest.resolve() == whole  # for all other tasks
    assert folders.run_folder("runs/latest", None) == str(burst)  # gone on with, as it was begun last
    refused = run("refused")
    assert folders.is_empty(refused)
    folders.discard(refused)
    assert not refused.exists() and not unfinished.is_symlink()
    assert not folders.is_empty(whole)


def test_where_no_training_has_ended_it_is_said(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(root)  # the checkout has runs of its own
    with pytest.raises(InputError, match="no training has come to its end: train, or name a run"):
        folders.run_folder(None, "runs/latest")


@pytest.mark.parametrize(
    "study", ["../../x", "/tmp/x", "a/b", "..", ".", "", ".hidden", "latest", "snapshots", "a b", "x\n"]
)
def test_a_study_that_is_no_folder_in_runs_is_refused_before_one_is_made(root: Path, study: str) -> None:
    before = set(root.rglob("*"))
    with pytest.raises(InputError, match="names the folder runs/<study>"):
        folders.study_folder(study)
    assert set(root.rglob("*")) == before


def test_a_link_that_cannot_be_made_is_not_worth_a_run(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = root / "runs" / "one"
    folder.mkdir()
    for name in ("surrogate.pt", "metrics.json"):
        (folder / name).touch()
    (root / "runs" / folders.LATEST).mkdir()  # in the way
    folders.end(folder)
    assert "runs/latest could not be set to one: Is a directory" in caplog.text
    assert {path.name for path in (root / "runs").iterdir()} == {"one", folders.LATEST}
