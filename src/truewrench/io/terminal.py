"""What results have in common where a person reads them in a terminal."""

from collections.abc import Iterable, Sequence

from rich import box
from rich.table import Table
from rich.text import Text


def verdict_text(usable: bool, good: str, words: str, reasons: Iterable[str]) -> Text:
    """What comes first: `good`, in words, where a result may be used, and why not where it may not."""
    text = Text()
    if usable:
        text.append(good, style="bold green").append(words)
    else:
        text.append("NOT TO BE USED AS IT STANDS", style="bold red")
    for reason in reasons:
        text.append(f"\n  - {reason}")
    return text


def titled_table(title: str, columns: Sequence[str]) -> Table:
    """One of names in the first column and numbers in the others."""
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(columns[0], overflow="fold")
    for column in columns[1:]:
        table.add_column(column, justify="right", no_wrap=True)
    return table
