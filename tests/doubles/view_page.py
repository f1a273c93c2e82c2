"""A page of the view without a browser: it keeps controls and drawn lines, and a test does what a user does there."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

BROWSER = object()


class Widget:
    """A control. `press` and `choose` are what a user does. A value that the program sets tells the callbacks too."""

    def __init__(self, label: str, folder: str, value: Any = None, **keys: Any) -> None:
        self.label, self.folder, self.visible, self.disabled = label, folder, True, False
        self._value = value
        self._presses: list[Callable[[Any], object]] = []
        self._updates: list[Callable[[Any], object]] = []
        self.__dict__.update(keys)

    def on_click(self, callback: Callable[[Any], object]) -> None:
        self._presses.append(callback)

    def on_update(self, callback: Callable[[Any], object]) -> None:
        self._updates.append(callback)

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        self._change(value, None)

    def choose(self, value: Any) -> None:
        self._change(value, BROWSER)

    def _change(self, value: Any, client: object) -> None:
        self._value = value
        for callback in self._updates:
            callback(SimpleNamespace(client=client))

    def press(self, value: Any = None) -> None:
        self._value = value
        for callback in self._presses:
            callback(SimpleNamespace(client=BROWSER))


class _Folder:
    def __init__(self, entered: list[str], label: str, widget: Widget) -> None:
        self._entered, self._label, self._widget = entered, label, widget

    def __enter__(self) -> Widget:
        self._entered.append(self._label)
        return self._widget

    def __exit__(self, *error: object) -> None:
        self._entered.pop()


class ViewPage:
    """Stands in for a viser server: it is its own `gui` and `scene`.

    added: all controls in order. lines: drawn line segments by path.
    """

    def __init__(self) -> None:
        self.gui = self.scene = self
        self.added: list[Widget] = []
        self.lines: dict[str, Any] = {}
        self.clicks: list[Callable[[Any], object]] = []
        self._folders: list[str] = []

    def __getitem__(self, label: str) -> Widget:
        return next(widget for widget in self.added if widget.label == label)

    def __contains__(self, label: str) -> bool:
        return any(widget.label == label for widget in self.added)

    def _add(self, label: str, value: Any = None, **keys: Any) -> Any:
        self.added.append(Widget(label, self._folders[-1] if self._folders else "", value, **keys))
        return self.added[-1]

    def add_folder(self, label: str, **keys: Any) -> Any:
        return _Folder(self._folders, label, self._add(label, **keys))

    def add_button(self, label: str, **keys: Any) -> Any:
        return self._add(label, **keys)

    def add_button_group(self, label: str, options: tuple[str, ...], **keys: Any) -> Any:
        return self._add(label, options=options, **keys)

    def add_dropdown(self, label: str, options: tuple[str, ...], *, initial_value: str, **keys: Any) -> Any:
        assert initial_value in options
        return self._add(label, initial_value, options=options, **keys)

    def add_slider(self, label: str, min: float, max: float, step: float, initial_value: float, **keys: Any) -> Any:
        assert min <= initial_value <= max
        return self._add(label, initial_value, min=min, max=max, step=step, **keys)

    def add_checkbox(self, label: str, initial_value: bool, **keys: Any) -> Any:
        return self._add(label, initial_value, **keys)

    def add_html(self, content: str, **keys: Any) -> Any:
        return self._add("html", content=content, **keys)

    def add_markdown(self, content: str, **keys: Any) -> Any:
        return self._add("markdown", content=content, **keys)

    def add_uplot(self, *, title: str, **keys: Any) -> Any:
        return self._add(title, **keys)

    def add_line_segments(self, path: str, points: Any, **keys: Any) -> Any:
        self.lines[path] = SimpleNamespace(**{"points": points, "visible": True, **keys})
        return self.lines[path]

    def on_click(self) -> Callable[[Callable[[Any], object]], None]:
        return self.clicks.append

    def remove_click_callback(self) -> None:
        self.clicks.clear()

    def set_up_direction(self, direction: str) -> None:
        assert direction == "+z"
