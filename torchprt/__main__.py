"""`python -m torchprt` is the command `torchprt`."""

from torchprt.cli import main

main()
