"""Insert parts by touch in a physics engine, and compare five methods on the same grasps."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from headless import choose_backend

from tactile_loc import StageStore, TactileLocError

FOLDER = Path("out/insertion")


def parse_arguments(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command's arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=12, help="number of trials, each with all methods (default 12)")
    parser.add_argument("--first-seed", type=int, default=1, help="seed of the first trial (default 1)")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder of the records; finished trials are kept")
    parser.add_argument("--store", type=Path, help="folder of built models (default: that of tactile-loc)")
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw success rates and forces")
    parser.add_argument("--video", type=Path, metavar="FILE", help="write a video (webm or gif) of one trial, and stop")
    parser.add_argument("--video-trial", type=int, default=0, help="number of the trial in the video (default 0)")
    options = parser.parse_args(arguments)
    if options.trials < 1 or min(options.first_seed, options.video_trial) < 0:
        parser.error("--trials needs a number above 0; --first-seed and --video-trial need 0 or more")
    return options


def run(options: argparse.Namespace) -> None:
    """Run the trials that are not in the records yet, and print the table."""
    from experiment import Experiment
    from records import NAME, append_records, format_table, read_records
    from trials import list_trials

    trials = list_trials(max(options.trials, options.video_trial + 1), options.first_seed)
    experiment = Experiment(options.out / "parts", StageStore(options.store))
    if options.video:
        from video import film

        film(experiment, trials[options.video_trial], options.video)
        return
    path = options.out / NAME
    trials = trials[: options.trials]
    finished = read_records(path, trials)
    if len(finished) < len(trials):
        show_progress(f"{len(finished)} of {len(trials)} trials are finished; the first one of each part takes longer")
    for trial in trials:
        if trial.number in finished:
            continue
        begun_s = time.monotonic()
        finished[trial.number] = experiment.run(trial)
        append_records(path, finished[trial.number])
        won = ", ".join(f"{r.method} {'yes' if r.success else 'no'}" for r in finished[trial.number])
        show_progress(
            f"{len(finished)} of {len(trials)} trials: {trial.part}, {trial.clearance_mm} mm: {won} "
            f"({time.monotonic() - begun_s:.0f} s)"
        )
    records = [record for number in sorted(finished) for record in finished[number]]
    print(format_table(records))
    if options.figure:
        from figure import draw_comparison

        draw_comparison(records, options.figure)


def show_progress(text: str) -> None:
    """Write one line of progress to stderr, with or without a terminal."""
    print(text, file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and return its exit status."""
    options = parse_arguments(arguments)
    choose_backend(drawing=options.video is not None)
    try:
        import mujoco  # noqa: F401
    except ImportError as error:
        print(f"this example needs MuJoCo ({error}); run: pip install 'tactile-loc[sim]'", file=sys.stderr)
        return 1
    try:
        run(options)
    except TactileLocError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; run the same command again to continue", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
