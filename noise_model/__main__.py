"""Train the networks that read noise, judge them, and stamp their weights."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

# NumPy reads this when it is imported. Training runs in processes of one thread each.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import stamp
import table
import train
import train_sizes
from configuration import WEIGHTS
from crops import folders_of_packages


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(prog="python noise_model", description=__doc__)
    commands = whole.add_subparsers(dest="command", required=True)
    first = commands.add_parser("train", help="the network that reads noise")
    sizes = commands.add_parser("train-sizes", help="the network that reads the size, and judge it")
    judge = commands.add_parser("judge", help="the weights of the installed package")
    for command in (first, sizes, judge):
        command.add_argument("folders", nargs="+", type=Path, help="with images")
        command.add_argument("--kinds", nargs="+", default=list(train.CHANNELS), choices=list(train.CHANNELS))
    for command in (first, sizes):
        command.add_argument("--processes", type=int, default=2)
        command.add_argument(
            "--weights", type=Path, default=WEIGHTS, help="the folder that they are written to"
        )
    first.add_argument("--observations", type=int, help="of each kind")
    first.add_argument("--epochs", type=int, default=train.EPOCHS)
    sizes.add_argument("--rows", type=int, help="of each family of noise")
    judge.add_argument("--part", default="test", choices=["validation", "test"], help="of the images")
    stamped = commands.add_parser("stamp", help="the weights with the code that they belong to")
    stamped.add_argument("--new", action="store_true", help="this code trained them: record its values")
    return whole


def main() -> None:
    options = parser().parse_args()
    if options.command == "stamp":
        stamp.stamp(are_new=options.new)
        return
    roots = [*options.folders, *folders_of_packages()]
    for kind in options.kinds:
        if options.command == "train":
            train.train_kind(
                kind, roots, options.weights,
                count=options.observations, epochs=options.epochs, processes=options.processes,
            )  # fmt: skip
        elif options.command == "train-sizes":
            train_sizes.train_kind(
                kind, roots, options.weights, count=options.rows, processes=options.processes
            )
        else:
            table.judge(roots, options.part, kind)


if __name__ == "__main__":
    main()
