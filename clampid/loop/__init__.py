"""The loop of identify, diagnose and add: by hand, undone, automatic, during a run, and as two worked examples."""
