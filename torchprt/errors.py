"""The one exception of the project that says "the input is at fault"."""


class InputError(ValueError):
    """A file or an argument that cannot be used.

    Its message is one sentence: which file or argument, what is wrong with it, what to do.
    The command line prints that sentence and exits with code 2; any other exception is a bug.
    """
