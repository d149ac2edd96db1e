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
        field.name: dict.fromkeys(costs.task, 0.0) if isinstance(getattr(costs, field.name), dict) else 0.0
        for field in fields(costs)
    }
    return simulate.Costs(**nothing | {"task": costs.task})


def work(stage, own, where=None, seconds=0.0, each=0.0, servers=1):
    station = stage.Station("slow", seconds, each, servers)
    places = {name: [station] if name == where else [] for name in ("before", "reading", "writing", "after")}
    return stage.Work(each=own, **places)


@pytest.mark.parametrize("most", [1, 2, 9, 1000])
@pytest.mark.parametrize("threads", [1, 3, 500])
@pytest.mark.parametrize("chunks", [1, 2, 17, 999, 12_345])
def test_batches_are_those_of_the_cluster(stage, chunks, threads, most):
    from torchprt.transport import cluster

    flight = object.__new__(cluster._Flight)
    flight._threads, flight._bytes, flight._seconds = threads, 0, cluster.SPAN
    left, wanted = chunks, []
    while left:
        flight._tasks = range(left)
        # None has ended when the first go out; then as many have in `SPAN` as may go together.
        flight._done = most if len(wanted) >= stage.IN_FLIGHT * threads else 0
        wanted.append(flight._size())
        left -= wanted[-1]
    first, whole, last = stage.batches(chunks, threads, most)
    assert [*first, *[most] * whole, *last] == wanted


@pytest.mark.parametrize("threads", [1, 2, 7, 1000])
@pytest.mark.parametrize("chunks", [1, 2, 13, 1999, 2_000_003])
def test_with_all_else_free_it_takes_as_many_chunks_as_the_busiest_thread_has(stage, chunks, threads):
    wanted = math.ceil(chunks / threads) * 0.05
    # Sums of that many numbers round.
    assert stage.makespan(chunks, threads, work(stage, 0.05)) == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("most", [5, 40])
@pytest.mark.parametrize("threads", [1, 7, 100])
@pytest.mark.parametrize("chunks", [1, 700, 1_000_003])
def test_batches_cost_no_more_than_one_of_them_at_the_end(stage, chunks, threads, most):
    found = stage.makespan(chunks, threads, work(stage, 0.05), most)
    # The last are one chunk each.
    assert chunks / threads * 0.05 - 1e-6 <= found <= (chunks / threads + 1 + (most if chunks < 1000 else 0)) * 0.05


@pytest.mark.parametrize("threads", [2, 100])
@pytest.mark.parametrize("chunks", [1, 150, 500_000])
@pytest.mark.parametrize("where", ["before", "after", "reading", "writing"])
def test_what_is_slower_than_all_else_sets_the_time(stage, chunks, threads, where):
    wanted = chunks * 0.01 + 1e-4
    found = stage.makespan(chunks, threads, work(stage, 1e-4, where, each=0.01))
    assert found == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("most", [1, 8])
def test_a_slow_scheduler_takes_its_time_for_every_batch(stage, most):
    chunks, threads = 100_000, 50
    first, whole, last = stage.batches(chunks, threads, most)
    found = stage.makespan(chunks, threads, work(stage, 1e-5, "before", seconds=0.01), most)
    # And the last batch on its thread.
    assert found == pytest.approx((len(first) + whole + len(last)) * 0.01 + 1e-5, rel=1e-9)


def test_two_servers_take_half_the_time_of_one(stage):
    times = [stage.makespan(100_000, 50, work(stage, 0.0, "before", each=0.01, servers=n)) for n in (1, 2)]
    assert times == pytest.approx([1000, 500], rel=1e-9)


def test_a_thread_waits_where_two_batches_in_flight_do_not_cover_the_way(stage):
    chunks, slow = 100_000, work(stage, 0.1, "after", each=1.0, servers=1000)
    # Six on their way at any time; two more or less where what is followed begins and ends.
    assert stage.makespan(chunks, 3, slow) == pytest.approx(chunks / 6 * 1.1, rel=1e-2)


@pytest.mark.parametrize(("own", "each", "seconds"), [(0.05, 0.003, 0.002), (0.01, 0.003, 0.0), (0.02, 0.0, 0.004)])
@pytest.mark.parametrize("where", ["before", "reading", "after"])
@pytest.mark.parametrize(("threads", "most"), [(1, 1), (8, 4), (30, 1)])
def test_batches_that_are_not_followed_take_as_long_as_if_they_were(
    stage, monkeypatch, own, each, seconds, where, threads, most
):
    given = work(stage, own, where, seconds, each)
    found = stage.makespan(20_011, threads, given, most)
    monkeypatch.setattr(stage, "FEW", 10**9)
    # One batch on all threads more or less.
    assert found == pytest.approx(stage.makespan(20_011, threads, given, most), abs=most * (own + each * threads))


@pytest.mark.parametrize(
    ("processes", "rounds"), [(1, 0), (2, 1), (3, 1), (4, 2), (9, 2), (10, 3), (27, 3), (243, 5), (244, 6), (1000, 7)]
)
def test_every_round_of_a_broadcast_makes_three_of_one(simulate, processes, rounds):
    # What a process passes on costs a second, to the scheduler, to the first worker, and in each round at least once;
    # at most as often as one worker is chosen by chance.
    found = simulate.broadcast(1e9, simulate.Cluster(processes, link=math.inf), hop=1e-9)
    assert 2 + rounds <= found <= 2 + 8 * rounds
    assert found == round(found, 6)


@pytest.mark.parametrize(("machines", "copies"), [(1, 0), (2, 1), (3, 2)])
def test_a_broadcast_waits_for_the_link_of_whoever_sends_most(simulate, machines, copies):
    cluster = simulate.Cluster(machines, cores=1, link=1e9)
    # By way of the scheduler to the first, which sends to all others.
    assert simulate.broadcast(1e9, cluster) == pytest.approx(2 + copies)


def test_what_stays_on_a_machine_costs_no_link(simulate):
    cluster = simulate.Cluster(8, cores=8, link=1e9)
    assert simulate.broadcast(1e9, cluster) == pytest.approx(2)


def test_nothing_to_send_takes_no_time(simulate):
    assert simulate.broadcast(0.0, simulate.Cluster(100)) == 0


@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_one_worker_takes_the_sum_of_all_parts(simulate, costs, free, bounces):
    bake = simulate.Bake(512 * 300, bounces)
    each = costs.task["trace and keep" if bounces else "trace"] + bounces * costs.task["bounce"]
    found = simulate.simulate(bake, simulate.Cluster(1), free)
    assert found.seconds == pytest.approx(bake.receivers * each, rel=1e-9)
    assert found.efficiency == pytest.approx(1)
    assert found.wall == "workers"


@pytest.mark.parametrize("workers", [3, 100, 1000])
def test_where_all_but_rays_is_free_the_busiest_worker_sets_the_time(simulate, free, workers):
    bake = simulate.Bake(512 * 12_345, 0)
    wanted = math.ceil(bake.chunks / workers) * 512 * free.task["trace"]
    cluster = simulate.Cluster(workers, span=0.0)
    assert simulate.simulate(bake, cluster, free).seconds == pytest.approx(wanted, rel=1e-6)


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
    bake, cluster = simulate.Bake(10**7), simulate.Cluster(64)
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


@pytest.mark.usefixtures("simulate")
def test_the_page_has_the_tables_of_what_was_measured():
    """`scripts/docs scale` puts them there."""
    text = (FOLDER.parents[1] / "docs/scale.md").read_text(encoding="utf-8")
    for name, table in script("tables").tables().items():
        assert f"<!-- {name} -->\n{table}\n<!-- end of {name} -->" in text, name
