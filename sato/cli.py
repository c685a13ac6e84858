"""The command line. Says what happened in a sentence, and keeps what takes long for later."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sato.cli_errors import EXIT_FAILED, EXIT_OK, ensure_writable, report_errors

if TYPE_CHECKING:
    from sato.record import Run

app = typer.Typer(
    help="Planning for swarms of vehicles: who goes where, and how to get there.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # its help would take longer to import than to read
)

RunFolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="The folder of a run.")]


def main() -> None:
    """Entry point."""
    app()


@app.callback(invoke_without_command=True)
def _print_version(
    version: Annotated[bool, typer.Option("--version", help="Say the version and stop.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as version_of

        typer.echo(version_of("sato"))
        raise typer.Exit(EXIT_OK)


@app.command()
def scenarios() -> None:
    """List the built-in scenarios."""
    with report_errors():
        from sato.former import names

        known = names()
        width = max(map(len, known))
        for name, says in known.items():
            typer.echo(f"{name:{width}}  {says}")


@app.command()
def run(
    scenario: Annotated[
        str, typer.Argument(metavar="NAME|FILE.toml", help="A built-in scenario, or a file.")
    ],
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is drawn.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where to write; runs/NAME-SEED.")
    ] = None,
    override: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="TABLE.KEY=VALUE", help="Change the scenario; repeatable."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing but what is wrong.")] = False,
) -> None:
    """Fly a scenario; write DIR/run.nc and DIR/summary.json."""
    with report_errors():
        from sato.console import print_summary, show_mission_progress
        from sato.former import read
        from sato.record import RUN_FILE
        from sato.simulate import run as fly
        from sato.systems import load_system

        asked = read(scenario, override or ())
        folder = out or Path("runs", f"{asked.name}-{seed}")
        ensure_writable(folder)
        if not quiet and (folder / RUN_FILE).exists():
            typer.echo(f"sato: {folder}: the run that is there will be overwritten", err=True)
        with show_mission_progress(quiet, load_system(asked.system).progress) as watch:
            flown = fly(asked, seed=seed, progress=watch)
        flown.save(folder)
        if not quiet:
            print_summary(flown, folder)
        raise typer.Exit(_exit_code(flown))


@app.command()
def check(
    folder: RunFolderArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, for a machine.")] = False,
) -> None:
    """Judge a run from its file alone; exit 1 if any promise is broken."""
    with report_errors():
        from sato.console import print_report, spinner
        from sato.record import json_default, load

        with spinner("judging the run by recomputing it"):
            report = load(folder).check()
        if as_json:
            typer.echo(json.dumps(report.as_dict(), indent=2, default=json_default))
        else:
            print_report(report)
        raise typer.Exit(EXIT_OK if report.kept else EXIT_FAILED)


@app.command()
def plot(
    folder: RunFolderArgument,
    pdf: Annotated[bool, typer.Option("--pdf", help="PDF instead of PNG.")] = False,
) -> None:
    """Draw the figures of a run into its folder."""
    with report_errors():
        from sato.console import spinner
        from sato.figures import plot as draw
        from sato.record import load

        with spinner("drawing"):
            figures = draw(load(folder), _run_folder(folder), pdf=pdf)
        for path in figures:
            typer.echo(str(path))


@app.command()
def animate(folder: RunFolderArgument) -> None:
    """Film a run into its folder: MP4, or GIF where ffmpeg is missing."""
    with report_errors():
        from sato.console import progress_bar
        from sato.record import load
        from sato.render import animate as film

        with progress_bar("filming") as progress:
            film_at = film(load(folder), _run_folder(folder), progress=progress)
        typer.echo(str(film_at))


@app.command()
def export(
    folder: RunFolderArgument,
    format: Annotated[
        str,
        typer.Option(
            "--format", metavar="oem|csv", help="CCSDS OEM, a file an object; or one table."
        ),
    ] = "oem",
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Where to write; DIR/oem/ or DIR/trajectories.csv."),
    ] = None,
) -> None:
    """Write the trajectories of a run for other tools."""
    with report_errors():
        from sato.export import DEFAULT_PATHS
        from sato.export import export as write
        from sato.record import load

        run = load(folder)
        typer.echo(
            str(write(run, out or _run_folder(folder) / DEFAULT_PATHS.get(format, format), format))
        )


@app.command()
def gains(
    formation: Annotated[
        str | None,
        typer.Argument(metavar="NAME|FILE.csv", help="Of the library, or points in metres."),
    ] = None,
    graph: Annotated[
        str,
        typer.Option(metavar="own|complete|FILE", help="Or pairs of vertices, counted from 0."),
    ] = "own",
    method: Annotated[
        str, typer.Option(metavar="auto|projection|sdp|admm|paper", help="How they are found.")
    ] = "auto",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="Where to write; gains/NAME.npz.")
    ] = None,
    list_library: Annotated[
        bool, typer.Option("--list", help="List the library and stop.")
    ] = False,
) -> None:
    """Design the gains of a formation; write them with what is certain of them."""
    with report_errors():
        from sato.design_gains import (
            default_path,
            design_and_save,
            print_formations,
            resolve_formation,
        )

        if list_library:
            print_formations()
            raise typer.Exit(EXIT_OK)
        if formation is None:
            raise ValueError("gains takes a formation, NAME or FILE.csv; --list has the names")
        shape = resolve_formation(formation, graph)
        file = out or default_path(shape)
        if file.suffix != ".npz" or file.is_dir():
            raise ValueError(f"{file}: --out takes a file that ends in .npz")
        ensure_writable(file.parent)
        design_and_save(shape, method, file)


@app.command()
def compare(
    family: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Of questions; repeatable; all.")
    ] = None,
    solver: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Repeatable; all installed ones.")
    ] = None,
    tolerance: Annotated[
        list[float] | None,
        typer.Option(metavar="T", help="Repeatable; 1e-4, 1e-6 and 1e-8."),
    ] = None,
    size: Annotated[
        list[str] | None, typer.Option(metavar="small|medium|large", help="Repeatable; all.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Of which times are medians.")] = 3,
    patience: Annotated[
        float, typer.Option(metavar="S", help="Who took longer is asked for nothing larger.")
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the order in which they are asked.")] = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path(
        "runs", "compare"
    ),
) -> None:
    """Ask every solver the same, and judge every answer; exit 1 if the default one is wrong."""
    with report_errors():
        from problems.solvers import load_adapters
        from sato.compare.command import run_comparison
        from sato.compare.plan import make_plan

        plan = make_plan(
            load_adapters(),
            solver or (),
            family or (),
            size or (),
            tolerance or (),
            repeats,
            patience,
        )
        ensure_writable(out)
        violations = run_comparison(plan, out, seed)
        for violation in violations:
            typer.echo(f"sato: {violation}", err=True)
        raise typer.Exit(EXIT_FAILED if violations else EXIT_OK)


@app.command(name="export-c")
def export_c(
    out: Annotated[Path, typer.Option(metavar="DIR", help="A new folder, for the C.")],
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE.toml", help="Of which an agent is.")
    ] = "uiuc",
    neighbors: Annotated[
        int, typer.Option(metavar="K", min=1, help="Number of neighbors to make room for.")
    ] = 5,
    steps: Annotated[
        int | None, typer.Option(metavar="T", min=2, help="Of a flight; the first leg's.")
    ] = None,
) -> None:
    """Write C that solves one agent's transfer among its neighbors, for onboard computers."""
    with report_errors():
        from sato.console import spinner
        from sato.onboard import export_c as write
        from sato.onboard.export import describe

        ensure_writable(out)
        with spinner("writing the code"):
            written = write(scenario, out, neighbors, steps)
        typer.echo(describe(written))
        typer.echo(str(out))


def _run_folder(run: Path) -> Path:
    return run if run.is_dir() else run.parent


def _exit_code(run: "Run") -> int:
    said = run.summary
    came = any(said.get(word) for word in ("reached", "success"))  # as each system calls it
    done = came and said.get("broken") == [] and "stopped" not in said
    return EXIT_OK if done else EXIT_FAILED
