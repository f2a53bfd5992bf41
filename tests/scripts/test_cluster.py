"""`deep_contact.parallel` on a real Dask cluster of two processes of this machine: the same bits as without it, also
where a worker dies, and errors that say what is wrong."""

import gc
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from conftest import SCRIPTS, load_script, run_python

import deep_contact as dc
from deep_contact import parallel
from deep_contact.reporting import figures
from deep_contact.studies.parts import done

SMALL = ["--simulations", "8", "--steps", "300", "--bodies", "50", "60", "--seed", "5"]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two worker processes and a scheduler, on the loopback interface alone."""
    distributed = pytest.importorskip("distributed", reason="needs the package of the extra `cluster`")
    options = {"host": "127.0.0.1", "dashboard_address": None, "memory_limit": 0, "threads_per_worker": 1}
    import dask

    simulated((0, None))  # compiled here once, and not by every worker
    with dask.config.set({"temporary-directory": str(tmp_path_factory.mktemp("workers"))}):
        with distributed.LocalCluster(n_workers=2, processes=True, **options) as found:
            yield found


@pytest.fixture
def workers(cluster):
    with parallel.cluster(cluster.scheduler_address) as executor:
        yield executor


CODE = parallel.code()


def simulated(task):
    """The last bits of a run in two halves; where a folder is given, the first process to come here dies between."""
    seed, folder = task
    half = dc.simulate(dc.circles_in_box(40, seed=seed), steps=150).state
    if folder is not None:
        try:
            Path(folder, "killed").touch(exist_ok=False)
            os.kill(os.getpid(), signal.SIGKILL)
        except FileExistsError:
            pass
    run = dc.simulate(half, steps=100)
    return [array.tobytes() for array in (*run.state.bodies, *run.state.contacts, run.sweeps, run.theta)]


def sweeps_of(n_bodies, seed):
    run = dc.simulate(dc.circles_in_box(n_bodies, seed=seed), steps=200)
    return {"sweeps": run.sweeps, "speed": run.state.bodies.velocity}


def refuse_two(number):
    if number == 2:
        raise ArithmeticError(f"refused: {number}")
    time.sleep(0.1)
    return number


def settled(condition):
    """Whether a condition comes true within a time that is no matter of speed."""
    until = time.monotonic() + 30
    while not condition() and time.monotonic() < until:
        time.sleep(0.05)
    return condition()


def unfinished(cluster):
    """The scheduler's tasks that wait or are being done."""
    return [task for task in list(cluster.scheduler.tasks.values()) if task.state not in ("memory", "erred")]


# ---- the same results ----


def test_a_worker_that_dies_in_the_middle_loses_nothing(workers, tmp_path):
    found = figures.parallel_map(simulated, [(seed, str(tmp_path)) for seed in range(6)], jobs=workers)
    assert (tmp_path / "killed").exists()
    assert found == [simulated((seed, None)) for seed in range(6)]


def test_data_and_figures_are_the_same(cluster, tmp_path):
    """Through the command lines."""
    figure = load_script("figure_3_7_baselines").FIGURE
    small = [item for name in ("n_bodies=20", "steps=150", "sweeps=60", "scenes=1") for item in ("--set", name)]
    for name, where in (("near", ["--jobs", "1"]), ("far", ["--scheduler", cluster.scheduler_address])):
        run_python(SCRIPTS / "generate_data.py", *SMALL, "--out", tmp_path / name, *where)
        assert figures.main(figure, [*small, "--out", str(tmp_path / f"{name} figure"), *where]) == 0
    near, far = ({path.name: path.read_bytes() for path in (tmp_path / k).iterdir()} for k in ("near", "far"))
    assert len(near) == 8
    assert far == near
    near, far = (dc.results.read_results(tmp_path / f"{k} figure" / "figure_3_7.json") for k in ("near", "far"))
    assert far["data"] == near["data"]


def test_a_study_stores_what_workers_return(workers, tmp_path):
    """And does not ask for it again."""
    parts = [("errors", {"n_bodies": n, "seed": 1}) for n in (20, 10, 15)]
    far = done(parts, {"errors": sweeps_of}, work=tmp_path, jobs=workers, text="")
    assert far == [dc.results.plain(sweeps_of(**arguments)) for _, arguments in parts]
    assert done(parts, {"errors": None}, work=tmp_path, jobs=1, text="") == far


# ---- errors and interrupts ----


def interrupted(results, **_):
    """A progress bar at which Ctrl-C is pressed after the first result."""
    yield next(results)
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("first", "progress", "error"), [(2, None, ArithmeticError), (7, interrupted, KeyboardInterrupt)]
)
def test_an_error_or_an_interrupt_leaves_no_tasks_behind(cluster, workers, first, progress, error):
    with pytest.raises(error):
        figures.parallel_map(refuse_two, [first, *range(3, 200)], jobs=workers, progress=progress)
    assert settled(lambda: not unfinished(cluster))
    assert figures.parallel_map(refuse_two, [5], jobs=workers) == [5]


def test_a_worker_with_other_code_refuses(workers, monkeypatch):
    monkeypatch.setattr(parallel, "code", lambda: {**CODE, "numba": "0.1"})
    with pytest.raises(parallel.ClusterError, match=f"numba: expected 0.1 as the client has it, got {CODE['numba']}"):
        workers.submit(abs, -1).result()


def test_results_are_handed_on_and_not_kept(workers):
    with closing(parallel.finished(bytes, [10] * 6, jobs=workers)) as found:
        for _ in range(4):
            next(found)
        assert settled(lambda: len(workers._executor._futures) <= 3)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:{port}", "nowhere"])
def test_a_scheduler_that_does_not_answer_is_named(address):
    pytest.importorskip("distributed", reason="needs the package of the extra `cluster`")
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = address.format(port=unused.getsockname()[1])
        with pytest.raises(parallel.ClusterError, match=f"answers at {address} within 0.5 s, got none"):
            with parallel.cluster(address, timeout=0.5):
                pass
    # One that is left would close itself whenever it is collected, and may hang the start of the next.
    from distributed import Client

    assert not [found for found in gc.get_objects() if type(found) is Client and found.status != "closed"]


def test_a_script_reports_it_without_a_traceback(tmp_path, capsys, monkeypatch):
    """Also where the package is missing."""
    pytest.importorskip("distributed", reason="needs the package of the extra `cluster`")
    arguments = ["--scheduler", "nowhere", "--out", str(tmp_path)]
    assert figures.main(load_script("figure_3_7_baselines").FIGURE, arguments) == 1
    assert "figure_3_7: scheduler: expected a Dask scheduler that answers at nowhere" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert load_script("generate_data").main(arguments) == 1
    message = capsys.readouterr().err
    assert "expected the package `distributed` to be installed for nowhere" in message
    assert "the extra `cluster`" in message


# ---- local processes ----


@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    """They would wait for tasks for ever; the pipe of standard output ends once the last of them has."""
    code = "import time; from deep_contact import parallel\nif __name__ == '__main__':\n    print('up', flush=True)\n"
    (tmp_path / "parent.py").write_text(code + "    list(parallel.finished(time.sleep, [1, 1, 60], jobs=2))\n")
    process = subprocess.Popen([sys.executable, str(tmp_path / "parent.py")], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"up\n"
    time.sleep(1.5)  # so that the processes are there
    process.kill()
    process.communicate(timeout=30)


def test_the_digest_of_the_sources_leaves_out_the_scripts_of_a_wheel(tmp_path, monkeypatch):
    """A client in a checkout and a worker with the wheel run the same code."""
    (tmp_path / "io").mkdir()
    for name in ("parallel.py", "io/files.py"):
        (tmp_path / name).write_text(name)
    monkeypatch.setattr(parallel, "__file__", str(tmp_path / "parallel.py"))
    checkout = parallel.code.__wrapped__()
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "figure_3_7.py").write_text("")
    assert parallel.code.__wrapped__() == checkout
    (tmp_path / "io" / "files.py").write_text("changed")
    assert parallel.code.__wrapped__() != checkout
