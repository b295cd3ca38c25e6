"""How a grid of points is run, kept and shown: study, plan, graph, run, journal, archive, report."""
