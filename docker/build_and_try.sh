#!/usr/bin/env bash
# Builds the image from nothing but Debian's packages and wheels, runs it as its settings say, as its
# own user and over a root that cannot be written, asks it for anchors and prints its size.
#
# Needs root, buildah, debootstrap and Python 3.11, which is what Debian 12 has: the wheels are
# fetched here, with the pip settings of this machine, and installed there. Where one of them is
# missing, or the machine too slow, it says so and ends well. FOLDER keeps the base for the next time.
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
BASE_LIMIT_S="${BASE_LIMIT_S:-1200}"
BUILD_LIMIT_S="${BUILD_LIMIT_S:-1800}"

skip() {
    echo "skipped: the image: $1"
    exit 0
}

step() { echo "image: $*"; }

failed() {
    echo "image: $1 failed:"
    tail -n 40 "$2"
    exit 1
}

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
        timeout "$BASE_LIMIT_S" debootstrap --variant=minbase --include=python3 "$SUITE" "$ROOTFS" \
            >"$FOLDER/base.log" 2>&1 \
            || skip "no base within $BASE_LIMIT_S s: $(tail -n 1 "$FOLDER/base.log")"
        # What Debian's own slim images leave out too.
        rm -rf "$ROOTFS"/var/cache/apt/archives/*.deb "$ROOTFS"/var/lib/apt/lists/* \
            "$ROOTFS"/usr/share/{doc,info,locale,man}
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
        hatchling "$REPOSITORY[service,zenoh,otel,language]" >"$FOLDER/wheels.log" 2>&1 \
        || failed "fetching wheels" "$FOLDER/wheels.log"
    step "building"
    local status=0
    # The docker format, because OCI's has no health check.
    timeout "$BUILD_LIMIT_S" \
        buildah bud --isolation chroot --format docker --tag "$IMAGE" \
        --build-arg BASE_IMAGE="$BASE" \
        --build-arg PIP_OPTIONS="--no-index --find-links /wheels" \
        --volume "$WHEELS:/wheels:ro" \
        --file "$REPOSITORY/docker/Dockerfile" "$REPOSITORY" >"$FOLDER/build.log" 2>&1 || status=$?
    [ "$status" != 124 ] || skip "not built within $BUILD_LIMIT_S s"
    [ "$status" = 0 ] || failed "building" "$FOLDER/build.log"
}

# Parts of the image's settings, a word a line: what a container runtime would run.
setting() {
    buildah inspect --type image "$IMAGE" | python3.11 -c '
import json, sys
settings = json.load(sys.stdin)["Docker"]["config"]
for name in sys.argv[1:]:
    value = settings
    for key in name.split("."):
        value = value[key]
    print(*([value] if isinstance(value, str) else value), sep="\n")
' "$@"
}

# A command in the image: its user, its environment, its root not to be written but for /tmp.
in_image() (exec_in_image "$@")

# The same in place of this shell, so that a signal to it reaches the command.
exec_in_image() {
    local environment
    mapfile -t environment < <(setting Env)
    exec unshare --mount -- bash -euc '
        root="$1"; user="$2"; shift 2
        mount --bind "$root" "$root"
        mount -o remount,bind,ro "$root"
        mount -t tmpfs tmpfs "$root/tmp"
        mount --bind /proc "$root/proc"
        exec chroot --userspec="$user" "$root" /usr/bin/env -i "$@"
    ' in_image "$ROOT" "$(setting User)" "${environment[@]}" \
        ANCHORFLOW_URL="http://127.0.0.1:$PORT" "$@"
}

try_image() {
    local container command health server status=0
    container="$(buildah from "$IMAGE")"
    ROOT="$(buildah mount "$container")"
    mapfile -t command < <(setting Entrypoint Cmd)
    mapfile -t health < <(setting Healthcheck.Test)
    step "running ${command[*]}"
    exec_in_image "${command[@]}" --port "$PORT" >"$FOLDER/server.log" 2>&1 &
    server=$!
    in_image python - "http://127.0.0.1:$PORT" "$READY_S" <"$REPOSITORY/docker/ask.py" \
        && in_image "${health[@]:1}" && step "its health check says that it is well" || status=$?
    kill -TERM "$server" && wait "$server" || true
    if [ "$status" != 0 ]; then
        tail -n 40 "$FOLDER/server.log"
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
