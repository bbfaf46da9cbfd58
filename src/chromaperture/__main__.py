"""``chromaperture`` and ``python -m chromaperture``: the command line."""

import contextlib
import signal
import sys


def main() -> None:
    """Load the command line, which takes some 2 s, and run it; what fails before is one line too."""
    usual = signal.getsignal(signal.SIGINT) == signal.default_int_handler
    try:
        from chromaperture.cli.terminal import leave_at_once, prepare_output
        from chromaperture.system.errors import FREE_MEMORY, InputError, lacks_memory

        prepare_output()
        if usual:
            signal.signal(signal.SIGINT, leave_at_once)
        try:
            from chromaperture.system.threads import check_environment

            check_environment()
            from chromaperture.cli.main import main as run
        except InputError as error:
            sys.exit(_refuse(str(error)))
        except Exception as error:
            if not lacks_memory(error):
                raise
            sys.exit(_refuse(f"not enough memory to load the program; {FREE_MEMORY}"))
        finally:
            if usual:
                signal.signal(signal.SIGINT, signal.default_int_handler)
        run()
    except KeyboardInterrupt:
        _refuse("interrupted; nothing was begun")
        sys.exit(130)


def _refuse(message: str) -> int:
    with contextlib.suppress(OSError):  # of a full device
        print(f"error: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
