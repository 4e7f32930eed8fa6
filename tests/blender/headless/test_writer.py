"""Files that are written by a thread of their own: no error is lost."""

import pytest
from lib.writer import BackgroundWriter


def fail():
    raise MemoryError("no memory is left")


def test_an_error_is_raised_once():
    writer = BackgroundWriter()
    with pytest.raises(MemoryError):
        for i in range(9):
            writer.write(fail if i == 0 else int)
    assert writer.close() is None


def test_the_first_error_that_nobody_was_told_of_is_left_at_the_end():
    writer = BackgroundWriter()
    writer._waiting.append(writer._thread.submit(fail))
    error = writer.close()
    assert isinstance(error, MemoryError) and str(error) == "no memory is left"


def test_an_interrupt_while_it_waits_loses_no_error(monkeypatch):
    from lib import writer as module

    def interrupted(_futures):
        raise KeyboardInterrupt

    writer = BackgroundWriter()
    monkeypatch.setattr(module, "WAITING_MOST", 0)
    monkeypatch.setattr(module, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.write(fail)
    assert isinstance(writer.close(), MemoryError)
