"""A fleet is the same wherever it is compressed, and whoever is killed."""

import os

import numpy as np
import pytest
from fleet_folders import write_robots
from killing import killing, loky_workers

import consistent_id as ci


@pytest.fixture
def scheduler():
    """A Dask scheduler with two workers, as a cluster has one, and its workers."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills processes")
@pytest.mark.filterwarnings("ignore")  # of those who look after killed workers
@pytest.mark.parametrize("where", ["processes:2", "dask"])
def test_a_fleet_is_the_same_wherever_and_whoever_is_killed(tmp_path, where, request):
    pytest.importorskip("psutil")
    executor, workers = where, loky_workers
    if where == "dask":
        cluster = request.getfixturevalue("scheduler")
        executor = f"dask:{cluster.scheduler_address}"

        def workers():
            return [nanny.pid for nanny in cluster.workers.values() if nanny.pid]

    root = write_robots(tmp_path)
    problems = [ci.load_problem(root / f"robot{k}") for k in range(5)]
    here = ci.fleet.identify_fleet(problems)
    with killing(workers, 2) as killed:
        there = ci.fleet.identify_fleet(problems, executor=executor)
    assert killed
    np.testing.assert_array_equal(here.bodies.parameters, there.bodies.parameters)
    for one, other in zip(here.robots, there.robots, strict=True):
        np.testing.assert_array_equal(one.parameters, other.parameters)
