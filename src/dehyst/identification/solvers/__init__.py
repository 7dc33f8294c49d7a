"""Solvers of the convex program, with a certified duality gap.

Why not HiGHS alone, which is a dependency already? Its interior point on the dual linear program reaches the same
optimum of the least absolute deviations, but takes up to 6.5 times as long (one thread, columns of slip elements and a
spring):

    rows x columns    own solver    HiGHS     difference of the objectives
    3 000 x 40        0.13 s        0.13 s    4e-16
    10 000 x 60       0.11 s        0.68 s    1e-14
    20 000 x 100      0.53 s        3.46 s    1e-14

At 100 000 rows the row reduction of Portnoy and Koenker (1997) keeps the time to 1.3 s and bounds the memory. HiGHS
solves the other linear programs, and this one where rounding stops the interior point. `program` is the entrance.
"""
