"""A cluster that the tests of a room share."""

import pytest

from study.execution.cluster import Cluster
from tests.execution.loopback import loopback
from tests.execution.misbehaving import perform


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two workers of two threads each, which the tests leave alive."""
    pytest.importorskip("distributed", reason="Dask is not installed (extra 'dask')")
    with loopback(tmp_path_factory.mktemp("cluster"), threads=2) as made:
        assert Cluster(perform, made.file, jobs=None).reached()
        yield made
        assert all(worker.is_alive() for worker in made.workers)
