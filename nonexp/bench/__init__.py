"""Run time against error, side by side with Mitsuba's integrators: the command ``nonexp bench``.

=================  ===============================================================================
``scenes``         the table of scenes, and the laws each is filled with
``competitors``    the table of integrators, and where each takes part
``references``     what the right image is: closed forms, or long renders kept as EXR files
``measure``        renders passes of all competitors in turn
``worker``         the processes that they live in
``statistics``     error, bias, slope and efficiency from those passes
``results``        the file of results, and what changed between two of them
``report``         tables and plots
``run``            whole runs, and their files
``scaling``        how time and memory grow with samples, pixels, media, depth, thickness
=================  ===============================================================================

A new scene or competitor is one more entry of its table.
"""
