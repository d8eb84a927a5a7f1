"""Scenes and the files that they come from.

=================  ===============================================================================
``load``           scene files with parameters and an image size
``meshes``         merging meshes
``parse``          scene files through Mitsuba's parser
``files``          the files that make up a scene
``identity``       what identifies a render
``cloud``          a procedural cloud
``walk``           the objects that a scene holds
``messages``       what is wrong, in one sentence
=================  ===============================================================================
"""
