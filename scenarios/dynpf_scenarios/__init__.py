"""The scenarios that come with dynpf: one TOML file describes a whole run."""
