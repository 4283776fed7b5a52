"""What is in a log or a recording, in tables that a person reads in a terminal."""

from collections.abc import Iterator

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from truewrench.inspection.log import ColumnContent, LogContent
from truewrench.inspection.recording import RecordingContent, StreamContent, TopicContent
from truewrench.model.rig.strict import printable


def recording_summary(content: RecordingContent) -> Iterator[RenderableType]:
    """Topics and what they would be taken for, then rates, gaps and ranges of what can be read."""
    size = f"{content.messages} messages in {content.duration:.6g} s"
    yield Text(f"{content.path}: {content.format}, {size}")
    titles = ["topic", "type", "messages", "rate, Hz", "header to receipt, s", "frame_id", "taken as"]
    topics = _table("Topics", titles)
    streams = _table("Streams", ["columns", "samples", "rate, Hz", "jitter", "gaps", "longest, s", "late"])
    columns = _table("Columns", ["column", "smallest", "largest", "numbers", "NaN"])
    for topic in content.topics:
        delay = "-" if topic.delay is None else f"{topic.delay:.4g}"
        publishers = f" ({topic.publishers} publishers)" if topic.publishers > 1 else ""
        topics.add_row(
            Text(topic.topic),
            Text(topic.type + publishers),
            str(topic.messages),
            f"{topic.rate:.6g}",
            delay,
            Text(_framed(topic)),
            Text(topic.taken_as or "-"),
        )
        for stream in topic.streams:
            streams.add_row(Text(f"{topic.topic}: {_named(stream)}"), *_figures(stream))
            for column in stream.columns:
                columns.add_row(*_range(column), str(column.nan))
    yield topics
    if columns.rows:
        yield streams
        yield columns


def log_summary(content: LogContent) -> Iterator[RenderableType]:
    """Streams with their rates and gaps, then every column with its range."""
    yield Text(f"{content.path}: {content.rows} rows in {content.duration:.6g} s")
    titles = ["stream", "columns", "samples", "rate, Hz", "jitter", "gaps", "longest gap, s"]
    streams = _table("Streams", titles)
    for stream in content.streams:
        longest = max((gap.duration for gap in stream.gaps), default=0.0)
        streams.add_row(
            stream.name,
            str(len(stream.columns)),
            str(stream.samples),
            f"{stream.rate:.6g}",
            f"{100 * stream.jitter:.2g} %",
            str(len(stream.gaps)),
            f"{longest:.4g}" if stream.gaps else "-",
        )
    yield streams
    columns = _table("Columns", ["column", "smallest", "largest", "numbers", "empty", "NaN"])
    for stream in content.streams:
        for column in stream.columns:
            columns.add_row(*_range(column), str(column.empty), str(column.nan))
    yield columns
    if content.unknown:
        yield Text(f"Columns without a meaning here: {', '.join(content.unknown)}")


def _figures(stream: StreamContent) -> list[str]:
    longest = max((gap.duration for gap in stream.gaps), default=0.0)
    return [
        str(stream.samples),
        f"{stream.rate:.6g}",
        f"{100 * stream.jitter:.2g} %",
        str(stream.gap_count),
        f"{longest:.4g}" if stream.gaps else "-",
        str(stream.late),
    ]


def _framed(topic: TopicContent) -> str:
    more = f" and {len(topic.frames) - 1} more" if len(topic.frames) > 1 else ""
    return printable(topic.frames[0]) + more if topic.frames else "-"


def _range(column: ColumnContent) -> tuple[Text, str, str, str]:
    return (
        Text(column.name),
        f"{column.smallest:.6g}",
        f"{column.largest:.6g}",
        str(column.numbers),
    )


def _named(stream: StreamContent) -> str:
    first, last = stream.columns[0].name, stream.columns[-1].name
    return first if len(stream.columns) == 1 else f"{first} ... {last}"


def _table(title: str, columns: list[str]) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold", pad_edge=False)
    for i, column in enumerate(columns):
        words = i == 0 or column in ("type", "frame_id", "taken as")
        table.add_column(
            column, justify="left" if words else "right", overflow="fold" if words else "ellipsis"
        )
    return table
