"""Pages for tests: the text of a report, on whichever page, and a server of a folder."""

import threading
from contextlib import contextmanager


def both_pages(report):
    """Text of the first page of a report and of the second."""
    second = report.with_stem(f"{report.stem}-details")
    return report.read_text(encoding="utf-8") + second.read_text(encoding="utf-8")


@contextmanager
def served(home):
    """Server of the results and reports of a folder."""
    from study.api.serving import Folders, StudyServer

    with StudyServer(Folders(home / "results", home / "reports"), 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()
