// Included inside anonymous namespaces by what places and moves nodes.

// Breaks closer than this become one: shorter elements would only cost digits (their stiffness goes with 1 / length^3).
constexpr double kMergeDistance = 1e-5;
