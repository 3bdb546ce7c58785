#!/usr/bin/env bash
# Builds the image from nothing but Debian's packages and wheels, runs the server in it as a user
# that is not root over a root that cannot be written, asks it for anchors, and prints its size.
#
# Needs root, buildah, debootstrap and Python 3.11, which is what Debian 12 has: the wheels are
# fetched here, with the pip settings of this machine, and installed there. Without them it says
# what is missing and ends well. FOLDER keeps the base and the wheels for the next time.
set -euo pipefail

REPOSITORY="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
FOLDER="${FOLDER:-${TMPDIR:-/tmp}/anchorflow-image}"
SUITE=bookworm
BASE=localhost/anchorflow-base:$SUITE
IMAGE=localhost/anchorflow:latest
ROOTFS="$FOLDER/rootfs-$SUITE"
WHEELS="$FOLDER/wheels"
PORT="${PORT:-18099}"
READY_S=120

skip() {
    echo "skipped: the image: $1"
    exit 0
}

step() { echo "image: $1"; }

check_tools() {
    [ "$(id -u)" = 0 ] || skip "buildah in a chroot needs root"
    python3.11 -m pip --version >/dev/null 2>&1 || skip "no python3.11 with pip"
    if ! command -v buildah >/dev/null || ! command -v debootstrap >/dev/null; then
        command -v apt-get >/dev/null || skip "no buildah and no debootstrap"
        step "installing buildah and debootstrap"
        { apt-get update --quiet=2 && DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 \
            --yes --no-install-recommends buildah debootstrap; } >"$FOLDER/tools.log" 2>&1 \
            || skip "buildah and debootstrap cannot be installed: $(tail -n 1 "$FOLDER/tools.log")"
    fi
    unshare --mount true 2>/dev/null || skip "no mount namespaces"
    buildah info >/dev/null 2>"$FOLDER/buildah.log" \
        || skip "buildah does not work: $(tail -n 1 "$FOLDER/buildah.log")"
}

make_base() {
    if [ ! -e "$ROOTFS.done" ]; then
        step "making the base from Debian's packages"
        rm -rf "$ROOTFS"
        debootstrap --variant=minbase --include=python3 "$SUITE" "$ROOTFS" >"$FOLDER/base.log" 2>&1 \
            || skip "no base: $(tail -n 1 "$FOLDER/base.log")"
        rm -rf "$ROOTFS"/var/cache/apt/archives/*.deb "$ROOTFS"/var/lib/apt/lists/*
        touch "$ROOTFS.done"
    fi
    local container
    container="$(buildah from scratch)"
    buildah add --quiet "$container" "$ROOTFS" / >/dev/null
    buildah commit --quiet --rm "$container" "$BASE" >/dev/null
}

make_image() {
    step "fetching wheels"
    rm -rf "$WHEELS"
    python3.11 -m pip --quiet wheel --wheel-dir "$WHEELS" \
        hatchling "$REPOSITORY[service,zenoh,otel]" 2>"$FOLDER/wheels.log" \
        || { cat "$FOLDER/wheels.log"; exit 1; }
    step "building"
    # The docker format, because OCI's has no health check.
    buildah bud --quiet --isolation chroot --format docker --tag "$IMAGE" \
        --build-arg BASE_IMAGE="$BASE" \
        --build-arg PIP_OPTIONS="--no-index --find-links /wheels" \
        --volume "$WHEELS:/wheels:ro" \
        --file "$REPOSITORY/docker/Dockerfile" "$REPOSITORY" >"$FOLDER/build.log" 2>&1 \
        || { cat "$FOLDER/build.log"; exit 1; }
}

# Inside a mount namespace: the image's root, not to be written but for /tmp, seen by its own user.
in_image() {
    unshare --mount -- bash -euc '
        root="$1"; shift
        mount --bind "$root" "$root"
        mount -o remount,bind,ro "$root"
        mount -t tmpfs tmpfs "$root/tmp"
        mount --bind /proc "$root/proc"
        exec chroot --userspec=10001:10001 "$root" \
            env -i PATH=/opt/anchorflow/bin:/usr/bin:/bin HOME=/tmp PYTHONDONTWRITEBYTECODE=1 \
            PYTHONUNBUFFERED=1 "$@"
    ' in_image "$ROOT" "$@"
}

try_image() {
    local container server status=0
    container="$(buildah from "$IMAGE")"
    ROOT="$(buildah mount "$container")"
    step "serving"
    in_image anchorflow serve --port "$PORT" --log-format json --log-level info \
        >"$FOLDER/server.log" 2>&1 &
    server=$!
    in_image python - "http://127.0.0.1:$PORT" "$READY_S" <"$REPOSITORY/docker/ask.py" || status=$?
    kill -TERM "$server" && wait "$server" || true
    if [ "$status" != 0 ]; then
        cat "$FOLDER/server.log"
    else
        step "size $(du --summarize --block-size=1M "$ROOT" | cut --fields=1) MB unpacked," \
            "$(du --summarize --block-size=1M "$ROOT/opt/anchorflow" | cut --fields=1) MB of it the service"
    fi
    buildah rm "$container" >/dev/null
    return "$status"
}

mkdir -p "$FOLDER"
check_tools
make_base
make_image
try_image
