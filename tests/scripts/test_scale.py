"""Does the simulation of clusters keep to what can be said without it, and to what was measured?"""

import importlib.util
import json
import math
import sys
from dataclasses import fields, replace
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "scripts/scale"


def script(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up, and one imports the other by its name.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def stage():
    return script("stage")


@pytest.fixture(scope="module")
def simulate(stage):
    return script("simulate")


@pytest.fixture(scope="module")
def costs(simulate):
    return simulate.Costs.read()


@pytest.fixture(scope="module")
def free(simulate, costs):
    """Costs of which rays and hits are all."""
    nothing = {
        field.name: dict.fromkeys(costs.worker, 0.0) if isinstance(getattr(costs, field.name), dict) else 0.0
        for field in fields(costs)
    }
    own = {name: getattr(costs, name) for name in ("trace", "trace_and_keep", "bounce")}
    return simulate.Costs(**nothing | own)


def work(stage, seconds, before=0.0, after=0.0, reading=0.0):
    return stage.Work(
        [stage.Station("before", before)],
        [stage.Station("reading", reading)],
        seconds,
        [],
        [stage.Station("after", after)],
    )


@pytest.mark.parametrize("threads", [1, 2, 7, 1000])
@pytest.mark.parametrize("tasks", [1, 2, 13, 1999, 2_000_003])
def test_with_all_else_free_it_takes_as_many_tasks_as_the_busiest_thread_has(stage, tasks, threads):
    wanted = math.ceil(tasks / threads) * 0.05
    # Sums of that many numbers round.
    assert stage.makespan(tasks, threads, work(stage, 0.05)) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("threads", [2, 100])
@pytest.mark.parametrize("tasks", [1, 150, 500_000])
@pytest.mark.parametrize("where", ["before", "after", "reading"])
def test_what_is_slower_than_all_else_sets_the_time(stage, tasks, threads, where):
    wanted = tasks * 0.01 + 1e-4
    assert stage.makespan(tasks, threads, work(stage, 1e-4, **{where: 0.01})) == pytest.approx(wanted, rel=1e-9)


def test_two_servers_take_half_the_time_of_one(stage):
    times = [stage.makespan(100_000, 50, stage.Work([stage.Station("s", 0.01, n)], [], 0.0, [], [])) for n in (1, 2)]
    assert times == pytest.approx([1000, 500], rel=1e-9)


def test_a_thread_waits_where_two_tasks_in_flight_do_not_cover_the_way(stage):
    tasks, way = 100_000, 1.0
    slow = stage.Work([], [], 0.1, [], [stage.Station("way", way, servers=1000)])
    # Six on their way at any time; the middle of those that are followed is of some 160 such ways, one more or less.
    assert stage.makespan(tasks, 3, slow) == pytest.approx(tasks / 6 * 1.1, rel=1e-2)


@pytest.mark.parametrize(
    "costs_of", [(0.05, 0.003, 0.002, 0.001), (0.01, 0.003, 0.004, 0.001), (0.02, 0.0, 0.0, 0.004)]
)
@pytest.mark.parametrize("threads", [1, 8, 30])
def test_tasks_that_are_not_followed_take_as_long_as_if_they_were(stage, monkeypatch, costs_of, threads):
    seconds, before, after, reading = costs_of
    given = [work(stage, seconds, before, after, reading) for _ in range(2)]
    found = stage.makespan(20_011, threads, given[0])
    monkeypatch.setattr(stage, "FEW", 10**9)
    # One round of all threads more or less.
    assert found == pytest.approx(stage.makespan(20_011, threads, given[1]), abs=seconds + reading * threads)


@pytest.mark.parametrize(
    ("processes", "wanted"), [(1, 0), (2, 1), (3, 1), (4, 2), (9, 2), (10, 3), (27, 3), (243, 5), (244, 6), (1000, 7)]
)
def test_every_round_of_a_broadcast_makes_three_of_one(simulate, processes, wanted):
    assert simulate.rounds(processes) == wanted
    # With a network that costs nothing the rounds are what is left: the first worker, and each round.
    cluster = simulate.Cluster(processes, link=math.inf)
    assert simulate.broadcast(1e9, 1.0, cluster) == (pytest.approx(1.0 + wanted), 0.0)


@pytest.mark.parametrize(("machines", "copies"), [(1, 0), (2, 1), (3, 2)])
def test_a_broadcast_waits_for_the_link_of_whoever_sends_most(simulate, machines, copies):
    cluster = simulate.Cluster(machines, cores=1, link=1e9)
    # By way of the scheduler to the first, which sends to all others.
    assert simulate.broadcast(1e9, 0.0, cluster)[0] == pytest.approx(2 + copies)


def test_what_stays_on_a_machine_costs_no_link(simulate):
    cluster = simulate.Cluster(8, cores=8, link=1e9)
    assert simulate.broadcast(1e9, 0.0, cluster)[0] == pytest.approx(2)


def test_nothing_to_send_takes_no_time(simulate):
    assert simulate.broadcast(0.0, 0.0, simulate.Cluster(100)) == (0.0, 0.0)


@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_one_worker_takes_the_sum_of_all_parts(simulate, costs, free, bounces):
    bake = simulate.Bake(512 * 300, bounces)
    each = (costs.trace_and_keep if bounces else costs.trace) + bounces * costs.bounce
    found = simulate.simulate(bake, simulate.Cluster(1), free)
    assert found.seconds == pytest.approx(bake.receivers * each, rel=1e-9)
    assert found.efficiency == pytest.approx(1)
    assert found.wall == "workers"


@pytest.mark.parametrize("workers", [3, 100, 1000])
def test_where_all_but_rays_is_free_the_busiest_worker_sets_the_time(simulate, free, workers):
    bake = simulate.Bake(512 * 12_345, 0)
    wanted = math.ceil(bake.chunks / workers) * 512 * free.trace
    assert simulate.simulate(bake, simulate.Cluster(workers), free).seconds == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("remedy", ["as built", "together"])
@pytest.mark.parametrize("workers", [1, 30, 1000])
@pytest.mark.parametrize("receivers", [1, 10**5, 10**9])
def test_nothing_is_busier_than_the_bake_is_long(simulate, costs, receivers, workers, remedy):
    options = simulate.TOGETHER if remedy == "together" else {}
    found = simulate.simulate(simulate.Bake(receivers), simulate.Cluster(workers, **options), costs)
    assert all(0 <= share <= 1 + 1e-9 for share in found.use.values())
    assert found.seconds >= found.busy["workers"]
    assert found.fits == (receivers < 10**9)


def test_every_remedy_moves_the_wall_that_it_is_for(simulate, costs):
    bake, cluster = simulate.Bake(10**6), simulate.Cluster(64)
    before = simulate.simulate(bake, cluster, costs)
    for changes in (simulate.REMEDIES | simulate.FURTHER).values():
        after = simulate.simulate(bake, replace(cluster, **changes), costs)
        assert any(after.busy[each] < before.busy[each] for each in before.busy), changes


def test_it_takes_as_long_as_was_measured_with_two_workers(simulate, costs):
    measured = json.loads((FOLDER / "measured.json").read_text())
    count, cores = measured["scene"]["receivers"], measured["machine"]["cores"]
    # All of one machine: workers, scheduler and client share its cores, and nothing goes through a cable.
    here = simulate.Cluster(measured["workers"], link=math.inf, store=math.inf, shared_cores=cores)
    for bounces, name in ((0, "wall seconds of the bake"), (1, "wall seconds of the bake with bounces")):
        found = simulate.simulate(simulate.Bake(count, bounces), here, costs).seconds
        # What is put together are CPU seconds; others who use the machine make clocks go on meanwhile.
        assert found == pytest.approx(measured[name]["low"], rel=TOLERANCE)


# Of the time of a clock, by parts that were measured in other repeats.
TOLERANCE = 0.25
