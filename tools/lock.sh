#!/bin/sh
# Pin what is installed in .venv today: constraints.txt is what `make` installs from.
set -eu
cd "$(dirname "$0")/.."
{
    echo "# Versions that the tests pass with, for every extra. Written by \`make lock\`."
    .venv/bin/python -m pip --disable-pip-version-check freeze --exclude-editable --exclude xitl
} > constraints.txt
