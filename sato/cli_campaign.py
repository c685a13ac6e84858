"""Commands of campaigns; heavy imports stand inside the commands."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter
from typing import Annotated

from typer import Argument, Exit, Option, Typer

from sato.cli_errors import EXIT_FAILED, EXIT_OK, ensure_writable
from sato.terminal import echo

campaign_app = Typer(help="Fly many runs, and resume them.", no_args_is_help=True)

CampaignFolder = Annotated[Path, Argument(metavar="DIR", help="Folder of a campaign.")]
Words = list[str] | None
By = Annotated[Words, Option(metavar="COLUMN", help="Group by; repeatable; the file's.")]
Show = Annotated[
    Words, Option(metavar="TERM", help="COLUMN[/COLUMN][=VALUE][:STATISTIC]; repeatable.")
]
Where = Annotated[
    Words, Option(metavar="CONDITION", help="COLUMN=VALUE, or <, >=, !=; repeatable.")
]


@campaign_app.command(name="run")
def run_command(
    file: Annotated[Path, Argument(metavar="FILE.toml", help="Campaign.")],
    trials: Annotated[int | None, Option(min=1, help="Number of seeds; the file's.")] = None,
    resume: Annotated[bool, Option("--resume", help="Go on with the runs in DIR.")] = False,
    workers: Annotated[
        int | None, Option(min=1, metavar="W", help="Processes on this machine; one a core.")
    ] = None,
    scheduler: Annotated[
        str | None, Option(metavar="ADDRESS", help="Dask scheduler, in place of processes here.")
    ] = None,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder; runs/NAME.")] = None,
    keep: Annotated[
        str | None, Option(metavar="failures|all|none", help="Run files to keep; the file's.")
    ] = None,
    yes: Annotated[bool, Option("--yes", help="Fly more than a million runs.")] = False,
    allow_version: Annotated[
        bool, Option("--allow-version", help="Resume with another version or scenario.")
    ] = False,
) -> None:
    """Fly a campaign into one table, DIR/campaign.sqlite, a row a run."""
    from sato.campaigns.definition import read_campaign
    from sato.campaigns.engine import fly_campaign
    from sato.campaigns.table import SUCCESSES, open_table
    from sato.scenario.definition import errors_in
    from sato.scenario.errors import InputError

    with errors_in(""):
        if workers is not None and scheduler is not None:
            raise InputError("", "--workers are of this machine; a --scheduler has its own")
        campaign = read_campaign(file, trials=trials, keep=keep)
        folder = out or Path("runs", campaign.name)
        ensure_writable(folder)
    try:
        with _show_progress() as show, errors_in(""):
            fly_campaign(
                campaign,
                folder,
                resume=resume,
                workers=workers,
                scheduler=scheduler,
                allow_version=allow_version,
                allow_many=yes,
                progress=show,
            )
    except KeyboardInterrupt:
        with suppress(InputError):  # there is no table yet
            echo(f"sato: interrupted; {_describe(folder)}; --resume goes on", err=True)
            raise Exit(EXIT_FAILED) from None
        raise
    echo(_describe(folder))
    echo(str(folder))
    with open_table(folder) as table:
        exits, has_columns = table.exits(), table.has_further_columns()
    if exits and not any(exits[name] for name in SUCCESSES):
        echo(f"sato: none of {exits.total()} runs succeeded", err=True)
        raise Exit(EXIT_FAILED)
    if exits and not has_columns:
        echo("sato: the function of columns failed in all runs: see columns_error", err=True)
        raise Exit(EXIT_FAILED)


@campaign_app.command()
def status(folder: CampaignFolder) -> None:
    """Count the rows of a campaign by exit, also while it runs."""
    echo(_describe(folder))


@campaign_app.command()
def rerun(
    folder: CampaignFolder,
    row: Annotated[int, Argument(metavar="ROW", help="Its number.")],
    trust: Annotated[bool, Option("--trust", help="Run the functions that DIR names.")] = False,
    functions: Annotated[
        Path | None, Option(metavar="FILE.py", help="Run the functions of this file.")
    ] = None,
) -> None:
    """Fly a row again from itself, into DIR/runs/ROW; exit 1 if its summary differs."""
    from sato.campaigns.engine import fly_again
    from sato.campaigns.table import open_table

    with open_table(folder) as table:
        outcome, differing = fly_again(table, row, trust, functions)
    echo(f"{outcome['exit']}{': ' if outcome['error'] else ''}{outcome['error'] or ''}")
    if differing:
        echo(f"sato: differs from the row in {', '.join(differing)}", err=True)
    elif differing is not None:
        echo("equal to the row")
    if "summary" in outcome:
        echo(str(folder / "runs" / str(row)))
    raise Exit(EXIT_FAILED if differing else EXIT_OK)


@campaign_app.command()
def table(
    folder: CampaignFolder,
    by: By = None,
    show: Show = None,
    where: Where = None,
    rows: Annotated[bool, Option("--rows", help="List single runs.")] = False,
    sort: Annotated[
        str, Option(metavar="TERM", help="Sort single runs; the largest first by --sort=-TERM.")
    ] = "",
    markdown: Annotated[bool, Option("--markdown", help="As a table of Markdown.")] = False,
) -> None:
    """Tabulate groups of runs: rates and means with 95 % intervals, and other statistics."""
    from sato.campaigns.selection import group_runs, list_runs
    from sato.campaigns.table import open_table
    from sato.console import print_rows
    from sato.scenario.definition import errors_in

    with open_table(folder) as campaign, errors_in(""):
        given = campaign, by, show or (), where or ()
        shown = list_runs(*given, sort) if rows or sort else group_runs(*given).text()
    print_rows(*shown, markdown)


@campaign_app.command()
def plot(
    folder: CampaignFolder,
    by: By = None,
    show: Show = None,
    where: Where = None,
    scatter: Annotated[
        tuple[str, str] | None, Option(metavar="X Y", help="Columns or ratios of its axes.")
    ] = None,
    pdf: Annotated[bool, Option("--pdf", help="PDF instead of PNG.")] = False,
) -> None:
    """Draw rates, distributions, a grid and a scatter plot into the folder."""
    from sato.campaigns.figures import draw_campaign
    from sato.campaigns.table import open_table
    from sato.render import write_figures

    with open_table(folder) as campaign:
        figures = draw_campaign(campaign, by, show or (), where or (), scatter or ())
    for path in write_figures(figures, folder, pdf):
        echo(str(path))


@campaign_app.command()
def export(
    folder: CampaignFolder,
    format: Annotated[str, Option(metavar="csv|parquet", help="Parquet needs pyarrow.")] = "csv",
    out: Annotated[Path | None, Option(metavar="FILE", help="In DIR, if absent.")] = None,
) -> None:
    """Write all runs for other tools, a row a run."""
    from sato.campaigns.export import export as write
    from sato.campaigns.table import open_table

    path = out or folder / f"campaign.{format}"
    with open_table(folder) as campaign:
        ensure_writable(path.parent)
        echo(str(write(campaign, path, format)))


@campaign_app.command()
def report(
    folder: CampaignFolder,
    out: Annotated[Path | None, Option(metavar="FILE.html", help="In DIR, if absent.")] = None,
) -> None:
    """Write one HTML file with tables, figures and failed runs, which opens offline."""
    from sato.campaigns.report import write_report
    from sato.campaigns.table import open_table

    path = out or folder / "report.html"
    with open_table(folder) as campaign:
        ensure_writable(path.parent)
        echo(str(write_report(campaign, path)))


def _describe(folder: Path) -> str:
    from sato.campaigns.table import open_table

    with open_table(folder) as table:
        exits, runs = table.exits(), table.campaign.runs
    counts = ", ".join(f"{count} {name}" for name, count in exits.items())
    return f"{exits.total()} of {runs} runs{': ' if counts else ''}{counts}"


@contextmanager
def _show_progress() -> Iterator[Callable[[Counter[str], int], None]]:
    """Show a live line on a terminal, else a line at every tenth."""
    from rich.progress import BarColumn, Progress, TextColumn

    from sato.console import TextConsole

    console = TextConsole(stderr=True)
    began, first, tenth = perf_counter(), 0, -1
    text = TextColumn("{task.fields[line]}", markup=False)
    with Progress(BarColumn(), text, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=None, line="")

        def show(exits: Counter[str], runs: int) -> None:
            nonlocal first, tenth
            done = exits.total()
            if tenth < 0:
                first = done
            line = _live_line(exits, runs, done - first, perf_counter() - began)
            if console.is_terminal:
                bar.update(task, completed=done, total=runs, line=line)
            elif 10 * done // runs > tenth:
                echo(line, err=True)
            tenth = 10 * done // runs

        yield show


def _live_line(exits: Counter[str], runs: int, flown: int, elapsed: float) -> str:
    from sato.campaigns.table import SUCCESSES

    done = exits.total()
    parts = [f"{done}/{runs}"]
    if done:
        succeeded = sum(exits[name] for name in SUCCESSES)
        parts.append(f"{100 * succeeded / done:.1f} % succeeded")
    if flown:
        left = round((runs - done) * elapsed / flown)
        parts.append(f"{flown / elapsed:.3g} runs/s")
        parts.append(f"{left // 3600}:{left // 60 % 60:02}:{left % 60:02} left")
    return ", ".join(parts)
