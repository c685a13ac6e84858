"""Campaigns from Python."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from sato.campaigns.definition import Campaign
from sato.campaigns.engine import fly_campaign
from sato.campaigns.table import CampaignTable, open_table


def campaign(
    scenario: Any = (),
    *,
    function: Any = "",
    out: str | Path,
    trials: int = 1,
    seed: int = 0,
    grid: Mapping[str, Sequence[Any]] | None = None,
    draw: Mapping[str, Any] | None = None,
    case: Mapping[str, Mapping[str, Any]] | None = None,
    columns: Any = "",
    time_limit: float | None = None,
    keep: Literal["failures", "all", "none"] = "none",
    **options: Any,
) -> CampaignTable:
    """Fly many runs into one table.

    Worker processes import the caller's script, so that it calls this function under
    `if __name__ == "__main__":`, and functions stand at the top of a module or script.

    Args:
        scenario: Name, file, dict, mission, or function of a generator that returns a mission
            or a dict; or a list of them.
        function: In place of a scenario, function of a generator and of the keys below, which
            returns a dict of columns.
        out: Folder of the table.
        trials: Number of seeds, at each point of the grid.
        seed: First seed.
        grid: Values by key of the scenario, all combined.
        draw: Distributions by key, each as in a file: {"kind": "uniform", "low": 1.0, ...}.
        case: Values by key that belong together, by a name that the column "case" takes.
        columns: Function of a run that returns a dict of more columns.
        time_limit: Time after which a run is ended [s].
        keep: Runs whose files are kept in the folder.
        options: `resume`, `workers`, `scheduler`, `allow_version`, `allow_many` and `progress`, as
            in `sato.campaigns.engine.fly_campaign`.

    Returns:
        The table, opened to read: `rows()`, `exits()`, `to_pandas()`, `to_xarray()`.

    Raises:
        InputError: The campaign cannot be flown, or the folder holds another one.
        TableError: The table cannot be written; all rows until then are in it.
        WorkerError: Workers end at once, or the scheduler cannot be reached.
    """
    defined = Campaign(
        name=Path(out).name,
        scenario=scenario,
        function=function,
        trials=trials,
        seed=seed,
        grid=grid or (),
        draw=draw or (),
        case=case or (),
        columns=columns,
        time_limit=time_limit,
        keep=keep,
    )
    fly_campaign(defined, Path(out), **options)
    return open_table(out)
