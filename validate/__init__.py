"""Truth, experiments and the report: the only room that sees both the mesh and the grid."""
