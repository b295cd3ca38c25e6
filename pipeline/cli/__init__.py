"""The command line: `commands` parses and dispatches, `text` is what commands print, `completion` serves shells."""
