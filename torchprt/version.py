"""The version of the package, as files that it writes record it."""

VERSION = "0.1.0"
