"""Run time against error, side by side with Mitsuba's integrators: the command ``nonexp bench``.

=================  ===============================================================================
``scenes``         the table of scenes, and the laws each is filled with
``competitors``    the table of integrators, and the scenes in which each takes part
``references``     the right images: closed forms, or long renders stored as EXR files
``measure``        rendering passes of all competitors in turn
``worker``         the processes in which they run
``statistics``     error, bias, slope and efficiency from those passes
``results``        the file of results, and what changed between two of them
``report``         tables and plots
``run``            a whole run, and its files
``scaling``        how time and memory grow with samples, pixels, media, depth, thickness
``gradients``      derivatives of images beside Mitsuba's ``prbvolpath``
=================  ===============================================================================

A new scene or competitor is one more entry in its table.
"""
