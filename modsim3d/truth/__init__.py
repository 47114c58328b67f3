"""Ground truth: what cameras see of each vessel, from pixels, from geometry, or by an idealised rule of rectangles.

All three sources begin with `outlines`, which projects bodies (`silhouettes`: as polygons), and end with `occlusion`
and `truth_record`; `modes` says which vessels are annotated, and `camera_inside` finds a camera within a hull.
- analytic: `occlusion_order` finds who can hide whom (`overlaps`, `separating_axes`); `polygon_occlusion` cuts.
- rectangles: `rectangle_rule`, which cuts in the same way.
- rendered: `scan_conversion` finds whole silhouettes as `pixel_spans`, `clusters` the places where they overlap,
  `buffer_drawing` draws these (`triangles`), and `cluster_visibility` cuts the spans by what was drawn. The plain way,
  which `rendered` is tested against, is `full_frame`; `pixel_masks` compares one vessel's pixels with geometry.
"""
