"""Command line; heavy imports stand inside the commands."""

import json
from pathlib import Path
from typing import Annotated

import typer

from sato.cli_errors import EXIT_FAILED, EXIT_OK, CommandGroup, ensure_writable

app = typer.Typer(
    cls=CommandGroup,
    help="Planning for swarms of vehicles: assignment, trajectories, formation, connectivity.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # rich takes longer to import than the help to read
)

RunFolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")]
ScenarioArgument = Annotated[
    str, typer.Argument(metavar="NAME|FILE.toml", help="Built-in scenario, or a file.")
]
OverrideOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="TABLE.KEY=VALUE", help="Change the scenario; repeatable."),
]
MAX_SEED = 2**64 - 1


def main() -> None:
    """Run the command line."""
    app(prog_name="sato")


@app.callback(invoke_without_command=True)
def _print_version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as version_of

        typer.echo(version_of("sato-swarm"))
        raise typer.Exit(EXIT_OK)


@app.command()
def scenarios() -> None:
    """List the built-in scenarios."""
    from sato.scenario.file import scenarios as built_in

    known = built_in()
    width = max(map(len, known))
    for name, line in known.items():
        typer.echo(f"{name:{width}}  {line}")


@app.command()
def show(scenario: ScenarioArgument, override: OverrideOption = None) -> None:
    """Print a whole scenario, defaults filled in, as TOML."""
    from sato.scenario.file import read

    typer.echo(read(scenario, override or ()).to_toml(), nl=False)


@app.command()
def keys(
    system: Annotated[str, typer.Argument(metavar="SYSTEM", help="System, or its first letters.")],
) -> None:
    """List the keys of a system's scenario files: unit, default, values and meaning."""
    from sato.keys import format_keys

    typer.echo(format_keys(system), nl=False)


@app.command()
def run(
    scenario: ScenarioArgument,
    seed: Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Random seed.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder to write; runs/NAME-SEED.")
    ] = None,
    override: OverrideOption = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors and warnings only.")] = False,
) -> None:
    """Fly a scenario; write DIR/run.nc and DIR/summary.json."""
    from sato.console import print_summary
    from sato.record import RUN_FILE
    from sato.runs import run as fly
    from sato.scenario.file import read

    folder = out or Path("runs", f"{read(scenario, override or ()).name}-{seed}")
    ensure_writable(folder)
    if not quiet and (folder / RUN_FILE).exists():
        typer.echo(f"sato: {folder}: the run that is there will be overwritten", err=True)
    flown = fly(scenario, seed=seed, overrides=override or (), progress=not quiet)
    flown.save(folder)
    if not quiet:
        print_summary(flown.summary, folder)
    summary = flown.summary
    is_success = summary.get("success") and summary.get("broken") == []
    raise typer.Exit(EXIT_OK if is_success and "stopped" not in summary else EXIT_FAILED)


@app.command()
def check(
    folder: RunFolderArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON.")] = False,
) -> None:
    """Check a run by recomputing it from its file alone; exit 1 if a promise is broken."""
    from sato.console import print_report, spinner
    from sato.record import json_default
    from sato.runs import load

    with spinner("recomputing the run"):
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
    from sato.console import spinner
    from sato.runs import load

    with spinner("drawing"):
        figures = load(folder).plot(_run_folder(folder), pdf=pdf)
    for path in figures:
        typer.echo(str(path))


@app.command()
def animate(folder: RunFolderArgument) -> None:
    """Animate a run into its folder: MP4, or GIF where ffmpeg is missing."""
    from sato.console import progress_bar
    from sato.runs import load

    with progress_bar("animating") as progress:
        path = load(folder).animate(_run_folder(folder), progress=progress)
    typer.echo(str(path))


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
    from sato.export import DEFAULT_PATHS
    from sato.runs import load

    path = out or _run_folder(folder) / DEFAULT_PATHS.get(format, format)
    typer.echo(str(load(folder).export(path, format)))


@app.command()
def gains(
    formation: Annotated[
        str | None,
        typer.Argument(metavar="NAME|FILE.csv", help="Formation of the library, or points [m]."),
    ] = None,
    graph: Annotated[
        str,
        typer.Option(metavar="own|complete|FILE", help="Graph; a file lists pairs of vertices."),
    ] = "own",
    method: Annotated[
        str, typer.Option(metavar="auto|projection|sdp|admm|paper", help="Method of the design.")
    ] = "auto",
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.npz", help="File to write; gains/NAME.npz.")
    ] = None,
    list_library: Annotated[bool, typer.Option("--list", help="List the library.")] = False,
) -> None:
    """Design the gains of a formation; write them with their certificate."""
    from sato import gains_report
    from sato.scenario.errors import InputError, errors_in

    if list_library:
        gains_report.print_formations()
        raise typer.Exit(EXIT_OK)
    with errors_in(""):
        if formation is None:
            raise InputError("", "gains takes a formation, NAME or FILE.csv; --list has the names")
        shape = gains_report.resolve_formation(formation, graph)
        file = out or gains_report.default_path(shape)
        if file.suffix != ".npz" or file.is_dir():
            raise InputError("", f"{file}: --out takes a file that ends in .npz")
        ensure_writable(file.parent)
    gains_report.design_and_save(shape, method, file)


@app.command()
def compare(
    family: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Problem family; repeatable; all.")
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
    repeats: Annotated[int, typer.Option(min=1, help="Times are medians of so many.")] = 3,
    patience: Annotated[
        float,
        typer.Option(metavar="S", help="Skip larger sizes after a solve that took longer [s]."),
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the order of solves.")] = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write.")] = Path(
        "runs", "compare"
    ),
) -> None:
    """Solve one set of problems with every solver; exit 1 if the default solver is wrong."""
    from problems.solvers import load_adapters
    from sato.compare.plan import make_plan
    from sato.compare.report import run_comparison
    from sato.scenario.errors import errors_in

    with errors_in(""):
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
    for text in violations:
        typer.echo(f"sato: {text}", err=True)
    raise typer.Exit(EXIT_FAILED if violations else EXIT_OK)


@app.command(name="export-c")
def export_c(
    out: Annotated[Path, typer.Option(metavar="DIR", help="New folder for the C code.")],
    scenario: Annotated[
        str, typer.Option(metavar="NAME|FILE.toml", help="Scenario of the agent.")
    ] = "uiuc",
    neighbors: Annotated[
        int, typer.Option(metavar="K", min=1, help="Neighbors that there is room for.")
    ] = 5,
    steps: Annotated[
        int | None, typer.Option(metavar="T", min=2, help="Steps of a flight; the first leg's.")
    ] = None,
) -> None:
    """Write C code that solves one agent's transfer among its neighbors, for on board."""
    from sato.console import spinner
    from sato.onboard import export_c as write
    from sato.onboard.export import describe
    from sato.scenario.errors import errors_in

    ensure_writable(out)
    with spinner("writing the code"), errors_in(""):
        problem = write(scenario, out, neighbors, steps)
    typer.echo(describe(problem))
    typer.echo(str(out))


def _run_folder(run: Path) -> Path:
    return run if run.is_dir() else run.parent
