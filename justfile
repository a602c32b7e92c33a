# What CI runs, by name; `.ci/run` runs it all. just is optional: each recipe is one command.

# Everything that has to hold before a change lands
ci:
    .ci/run

# Formatting
format:
    cargo fmt --all --check

# core <- store <- server <- tests
direction:
    .ci/direction

# Lints
lint:
    cargo clippy --workspace --all-targets --locked -- -D warnings

# The controller that boards run, without std
no-std:
    cargo build -p feedwright-core --no-default-features --locked

# Every test, on SQLite and on a PostgreSQL of its own; with arguments, those tests
test *ARGUMENTS:
    tests/run {{ARGUMENTS}}

# Losses of power while machines post; with --seed and --moments, others and more
power-loss *OPTIONS:
    tests/power-loss/run {{OPTIONS}}

# The exported program on LinuxCNC itself
linuxcnc:
    tests/linuxcnc/run

# The closed loop on LinuxCNC
closed-loop:
    tests/closed-loop/run

# The pages in a browser
pages:
    tests/browser/run

# pandas and pyarrow read what is served
reading:
    tests/reading

# Deployment: lint, prometheus, package and watched, or the parts that are named
deploy *PARTS:
    tests/deploy/run {{PARTS}}

# The description of the API, written anew
openapi:
    cargo run -- openapi > openapi/openapi.json

# The dashboards, written anew
dashboards:
    deploy/grafana/generate

# The Debian package, from a release build
package:
    deploy/debian/build
