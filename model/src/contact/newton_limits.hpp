// How far Newton's steps go: included inside anonymous namespaces by newton.cpp and far_solutions.cpp.

constexpr double kKeep = 0.98;            // fraction of the way to the boundary
constexpr double kMaxTwistStep = 0.6;     // rad
constexpr double kExactLevel = 0.1;       // barrier level, see BarrierPath, below which exact geometry matters
constexpr double kMostDamping = 1e7;      // 1/m^2, with which angles stay where they are
constexpr int kMostAtLevel = 16;          // Newton steps, until they are full
