"""Looking over the engine's shoulder: Blender does not let methods be replaced on a registered class."""

from raybatch_addon.blender import frame


class WatchedEngine:
    """A render engine with some of its methods replaced."""

    def __init__(self, engine, methods):
        object.__setattr__(self, "_engine", engine)
        object.__setattr__(self, "_methods", methods)

    def __getattr__(self, name):
        if name in self._methods:
            return lambda *args, **options: self._methods[name](self._engine, *args, **options)
        return getattr(self._engine, name)

    def __setattr__(self, name, value):
        setattr(self._engine, name, value)


def watch_engines(monkeypatch, **methods):
    """Replaces `methods` of every engine that renders from now on; the functions get the real engine first."""
    original = frame.render_view_layer
    monkeypatch.setattr(
        frame, "render_view_layer", lambda engine, depsgraph: original(WatchedEngine(engine, methods), depsgraph)
    )
