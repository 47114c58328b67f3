"""Visible parts of each vessel in each camera: from pixels, from geometry, or by an idealised rule of rectangles.

All three sources begin with `outlines`, which projects bodies (`silhouettes`: as polygons), and end with `occlusion`
and `record`, which has the annotation modes too.
- Geometry: `occlusion_order` finds who can hide whom; `analytic` cuts, also by rectangles.
- Pixels: `scan_conversion` finds whole silhouettes, `cluster_visibility` the places where they overlap and what is seen
  of them, and `buffer_drawing` draws these for `rendered`. `full_frame` is the plain way that `rendered` is tested
  against.
"""
