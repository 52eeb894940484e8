"""The page in three dimensions as a part of another page, such as a report."""

from __future__ import annotations

import html

from markupsafe import Markup

from akm_fg.errors import MissingDependency
from akm_fg.model.records import ObjectModel
from akm_fg.view.contents import contents_of
from akm_fg.view.page import html_page

_MOST_POINTS = 12_000  # of each cloud: what stands around it opens on a phone
_UNFOLD = "const f = this.lastElementChild; if (this.open && !f.srcdoc) f.srcdoc = f.dataset.page"


def embedded_view(model: ObjectModel, title: str) -> Markup:
    """A frame to be unfolded, which holds its whole page; without viser a line that says how.

    Args:
        model: of the object.
        title: of the page inside.
    """
    try:
        page = html_page(contents_of(model, title, most_points=_MOST_POINTS))
    except MissingDependency as error:
        return Markup("<p class='soft'>{}</p>").format(str(error))
    # The inner page is whole: nothing is fetched. Browsers run a frame in a closed fold, lazy or
    # not, so that it gets its page when it is unfolded.
    start = f"<details class='view' ontoggle='{_UNFOLD}'>"
    frame = f"<iframe title='{html.escape(title)}, in three dimensions' "
    inside = html.escape(page, quote=True)
    summary = "<summary>Turn it, and play the recording</summary>"
    return Markup(f'{start}{summary}{frame}data-page="{inside}"></iframe></details>')
