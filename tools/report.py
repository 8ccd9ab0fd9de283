#!/usr/bin/python3
"""Makes the report of a hammering run.

    tools/report.py FOLDER                      writes FOLDER/report.html from result.json and telemetry.csv
    tools/report.py FOLDER --compare OTHER      beside another run, e.g. one with --mode never
    tools/report.py FOLDER --picture FILE       writes one overview picture (.png or .svg) instead

FOLDER may also hold experiment.json (`mrr hammer --experiment`), alone or beside the others, and compare.json with
compare.csv: result and telemetry of a run to compare with. Needs Debian's python3-numpy and python3-matplotlib.
"""

import os
import signal
import sys


def interrupted(*_):
    os.write(2, b"report.py: interrupted\n")
    os._exit(130)  # at once: an exception could be lost in a library, or leave a traceback


if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
    signal.signal(signal.SIGINT, interrupted)

import argparse  # noqa: E402
import contextlib  # noqa: E402
import pathlib  # noqa: E402
import tempfile  # noqa: E402

sys.dont_write_bytecode = True  # an installation may be shared


@contextlib.contextmanager
def interrupts_wait():
    """Ctrl-C takes effect afterwards: what is being written is finished or removed first."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@interrupts_wait()
def write_whole(path, data):
    """Through a temporary file in the same folder: the file is there whole or not at all."""
    handle, partial = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".partial")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(partial, 0o644)
        os.replace(partial, path)
    except BaseException:
        os.unlink(partial)
        raise


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0], epilog=__doc__.split("\n\n", 1)[1],
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--compare", type=pathlib.Path, metavar="OTHER", help="folder of another run")
    parser.add_argument("--picture", type=pathlib.Path, metavar="FILE", help="overview picture, .png or .svg")
    arguments = parser.parse_args()
    try:
        with interrupts_wait():  # matplotlib may be writing its list of fonts
            from mrr_report import data, page
    except ImportError as error:
        print(f"report.py: {error}; install Debian's python3-numpy and python3-matplotlib", file=sys.stderr)
        return 1
    try:
        if not arguments.folder.is_dir():
            raise data.ReportError(f"{arguments.folder}: is not a folder")
        if arguments.picture:
            if arguments.picture.suffix not in (".png", ".svg"):
                raise data.ReportError(f"{arguments.picture}: a picture's name ends in .png or .svg")
            run = data.load(arguments.folder)
            other = data.load_comparison(arguments.folder, arguments.compare)
            write_whole(arguments.picture, page.picture(run, other, arguments.picture.suffix[1:]))
        else:
            html = page.html(arguments.folder, arguments.compare)
            write_whole(arguments.folder / "report.html", html.encode("utf-8"))
    except data.ReportError as error:
        print(f"report.py: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"report.py: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    status = main()
    # All is written. While the interpreter ends, it would put the default back, and an interrupt would kill it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(status)
