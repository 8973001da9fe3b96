"""What packages with commands share: options, output on the terminal, failures and workers.

A package that adds commands to `tactile-loc` imports this module in the modules of its commands. It declares the
commands with `CommandSpec` and `hookimpl` of `tactile_loc.plugin`. Names are imported at their first use.
"""

# ruff: noqa: I001 - names are grouped by purpose

from typing import TYPE_CHECKING

from tactile_loc.core.runtime.lazy import lazy_names

if TYPE_CHECKING:
    # options: a parameter of type Annotated[RunOptions, Takes("object", ...)] becomes the options named there; a
    # parameter whose type is another dataclass of declared options becomes all of them
    from tactile_loc_cli.options import RunOptions as RunOptions, Takes as Takes
    from tactile_loc_cli.options import Store as Store
    from tactile_loc_cli.options import declare as declare
    from tactile_loc_cli.options import make_config as make_config
    from tactile_loc_cli.options import open_localizer as open_localizer
    from tactile_loc_cli.options import read_touches as read_touches

    # results go to stdout, all else to stderr; with --json, only the dictionary that a command returns is written
    from tactile_loc_cli.console import complain as complain, make_progress as make_progress
    from tactile_loc_cli.console import say as say, say_table as say_table, say_written as say_written
    from tactile_loc_cli.console import format_count as format_count
    from tactile_loc.core.runtime.errors import fold_line as fold_line
    from tactile_loc.core.runtime.formatting import format_bytes as format_bytes, format_mm as format_mm
    from tactile_loc.core.runtime.formatting import format_percent as format_percent

    # failures: a TactileLocError ends the command with exit code 2, a Finding with a result and an exit code
    from tactile_loc_cli.failures import Finding as Finding
    from tactile_loc_cli.failures import NOT_AS_REQUIRED as NOT_AS_REQUIRED
    from tactile_loc_cli.failures import UNEXPECTED as UNEXPECTED, USAGE_ERROR as USAGE_ERROR

    # workers of commands that run many jobs
    from tactile_loc_cli.workers import WorkerOptions as WorkerOptions

    # what the body that carries a sensor must not hit
    from tactile_loc_cli.commands.next_touch import Obstacles as Obstacles

    # identification
    from tactile_loc_cli.commands.identify import IdentificationOutput as IdentificationOutput

    # pictures and numbers in pages
    from tactile_loc.io.images import encode_png as encode_png, make_png_url as make_png_url
    from tactile_loc.reports.scene import pack_array as pack_array

    # files, which are written completely or not at all
    from tactile_loc.locate.stored_object import list_mesh_files as list_mesh_files
    from tactile_loc.store.files import remove_abandoned as remove_abandoned
    from tactile_loc.store.arrays import read_member as read_member
    from tactile_loc.store.files import list_files as list_files
    from tactile_loc.store.files import replace_file as replace_file
    from tactile_loc.store.files import write_atomically as write_atomically, write_json as write_json
    from tactile_loc.store.files import replace_folder as replace_folder

__all__, __getattr__, __dir__ = lazy_names(__name__)
