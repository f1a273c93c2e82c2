#!/bin/sh
# Build both images of Containerfile and try them: a short run, and the agent on ARM.
set -eu
cd "$(dirname "$0")/.."
tool=$(command -v podman || command -v docker) || { echo "install podman or docker" >&2; exit 2; }
"$tool" build -f Containerfile -t xitl .
"$tool" run --rm xitl .venv/bin/xitl sim sitl --duration 10 --out runs/try
for platform in linux/arm/v7 linux/arm64; do
    "$tool" build -f Containerfile --platform "$platform" --target agent -t xitl-agent .
    "$tool" run --rm --platform "$platform" xitl-agent --version
done
echo "the images work"
