"""A figure that shows itself by what it brings along: plotly's own ways of showing one fetch MathJax from a server elsewhere."""

import tempfile
import webbrowser
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

JSON = "application/vnd.plotly.v1+json"
"""What front ends that draw plotly's figures by themselves read."""
CONFIG = {"responsive": True, "displaylogo": False}


class ShownFigure(go.Figure):  # type: ignore[misc]
    """A plotly figure; what differs is how it is shown, in a notebook and by `show`: nothing is fetched."""

    def _repr_mimebundle_(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        return {JSON: {**self.to_plotly_json(), "config": CONFIG}, "text/html": self._repr_html_()}

    def _repr_html_(self) -> str:
        # every figure brings what draws it: a cell may be shown without the others
        return str(self.to_html(full_html=False, include_plotlyjs=True, include_mathjax=False, config=CONFIG))

    def _ipython_display_(self) -> None:
        from IPython import display

        show: Any = display.display
        show(self._repr_mimebundle_(), raw=True)

    def show(self, *args: Any, **kwargs: Any) -> None:
        """In a notebook below its cell, elsewhere in a browser; with arguments as plotly's figures do."""
        if args or kwargs:
            super().show(*args, **kwargs)
        elif _in_a_notebook():
            self._ipython_display_()
        else:
            page = Path(tempfile.mkdtemp(prefix="lmeasure-")) / "figure.html"
            self.write_html(page, include_plotlyjs=True, include_mathjax=False, config=CONFIG)
            webbrowser.open(page.as_uri())


def _in_a_notebook() -> bool:
    try:
        from IPython.core.getipython import get_ipython
    except ImportError:
        return False
    shell: Any = get_ipython()  # type: ignore[no-untyped-call]
    return shell is not None and getattr(shell, "kernel", None) is not None
