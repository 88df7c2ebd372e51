"""The stages, a file each; :func:`clampid.stages.stage_kind.kind_of` finds them by their names."""
