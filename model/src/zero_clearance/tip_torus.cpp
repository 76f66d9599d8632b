#include "ctr/tip_torus.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace ctr {
namespace {

constexpr int NEWTON = 20;               // steps
constexpr int FIRST_STEP = 3;            // times the steps of the first integration, which only tells where to go
constexpr double FAR = 0.6;              // the longest of a step [rad]
constexpr double SETTLED = 1e-9;         // of R [rad]
constexpr int COLLAR_STEPS = 8;          // behind the plate, where conjugate points are looked for
constexpr int SHAPE_STEPS = 2;           // of the shape, for a step from the tips: its backbone is of second order
constexpr double FLAT = 1e-9;            // angle of an arc below which it is a straight line [rad]
constexpr double WHOLE = 2 * std::numbers::pi;

double turned(double angle) { return angle - WHOLE * std::round(angle / WHOLE); }

// Determinant of a matrix of M rows, and the solution of A x = b in b; b is as it was where A is singular.
template <int M>
double solve(double (&A)[M][M], double* b) {
    double det = 1.0;
    for (int k = 0; k < M; ++k) {
        int pivot = k;
        for (int i = k + 1; i < M; ++i)
            if (std::abs(A[i][k]) > std::abs(A[pivot][k])) pivot = i;
        if (A[pivot][k] == 0.0) return 0.0;
        if (pivot != k) {
            std::swap(A[pivot], A[k]);
            if (b != nullptr) std::swap(b[pivot], b[k]);
            det = -det;
        }
        det *= A[k][k];
        for (int i = k + 1; i < M; ++i) {
            const double factor = A[i][k] / A[k][k];
            for (int j = k + 1; j < M; ++j) A[i][j] -= factor * A[k][j];
            if (b != nullptr) b[i] -= factor * b[k];
        }
    }
    if (b != nullptr)
        for (int k = M - 1; k >= 0; --k) {
            for (int j = k + 1; j < M; ++j) b[k] -= A[k][j] * b[j];
            b[k] /= A[k][k];
        }
    return det;
}

// Of N tubes; C columns: the angles themselves, or their N derivatives by the angles at the tips too.
template <int N, int C>
struct State {
    double q[N][C], v[N][C];  // [rad], [rad/m]
};

template <int N>
class Torus {
  public:
    static constexpr int P = N > 1 ? N - 1 : 1;  // pairs, one that stands still beside a single tube

    explicit Torus(const TorusTubes& tubes) : tubes_(tubes) {}

    static State<N, N + 1> at_tips(const double* psi) {
        State<N, N + 1> state{};
        for (int i = 0; i < N; ++i) {
            state.q[i][0] = i == 0 ? 0.0 : state.q[i - 1][0] + psi[i - 1];
            state.q[i][i + 1] = 1.0;
        }
        return state;
    }

    // From the tips to the plate; `visit` sees every state on the way, and the arc length where it is.
    template <class Visit>
    void shoot(State<N, N + 1>& state, double step, const Visit& visit) const {
        for (auto part = tubes_.stretches.rbegin(); part != tubes_.stretches.rend(); ++part) {
            const double length = part->end - part->begin;
            const int count = steps(*part, step);
            for (int k = 0; k < count; ++k) {
                advance(*part, state, length - k * length / count, -length / count);
                visit(state, part->begin + length - (k + 1) * length / count);
            }
        }
    }

    // Relative angles of the collars, and their derivatives by those of the tips.
    void relative(const State<N, N + 1>& state, double* R, double (&by)[P][P]) const {
        R[0] = 0.0;
        by[0][0] = 1.0;
        double whole[N][N];  // a tip turns all that are inside it
        for (int i = 0; i < N; ++i) {
            double sum = 0.0;
            for (int j = N - 1; j >= 0; --j) {
                sum += state.q[i][j + 1] + tubes_.behind[i] * state.v[i][j + 1];
                whole[i][j] = sum;
            }
        }
        for (int i = 0; i + 1 < N; ++i) {
            R[i] = collar(state, i + 1) - collar(state, i);
            for (int j = 0; j + 1 < N; ++j) by[i][j] = whole[i + 1][j + 1] - whole[i][j + 1];
        }
    }

    // Where angles at the tips lead to, which is the same whatever collars are asked for.
    struct Start {
        double R[P], by[P][P];
    };
    Start begin(const double* psi, double step) const {
        Start made;
        State<N, N + 1> state = at_tips(psi);
        shoot(state, FIRST_STEP * step, [](const auto&, double) {});
        relative(state, made.R, made.by);
        return made;
    }

    // Whether Newton's method from psi (N - 1,), where `start` begins, ends at a root, which is in `root` then.
    bool find(const double* psi, const Start& start, const double* alpha, double reach, double step, TorusRoot& root) const {
        double at[P] = {}, R[P], off[P] = {}, by[P][P], copy[P][P];
        std::copy(psi, psi + N - 1, at);
        for (int number = 0; number < NEWTON; ++number) {
            if (number == 0) {
                std::copy(start.R, start.R + P, R);
                std::copy(&start.by[0][0], &start.by[0][0] + P * P, &by[0][0]);
            } else {
                State<N, N + 1> state = at_tips(at);
                shoot(state, step, [](const auto&, double) {});
                relative(state, R, by);
            }
            double most = 0.0, longest = 0.0;
            for (int i = 0; i + 1 < N; ++i) {
                off[i] = turned(R[i] - alpha[i]);
                most = std::max(most, std::abs(off[i]));
            }
            std::copy(&by[0][0], &by[0][0] + P * P, &copy[0][0]);
            if (number > 0 && most < SETTLED) {
                const double det = solve<P>(copy, nullptr);
                root.sign = det > 0 ? 1 : det < 0 ? -1 : 0;
                root.psi.assign(at, at + N - 1);
                root.twist.resize(N - 1);
                for (int i = 0; i + 1 < N; ++i) root.twist[i] = R[i] - at[i];
                return true;
            }
            if (solve<P>(copy, off) == 0.0) return false;
            for (double x : off) longest = std::max(longest, std::abs(x));
            if (!(longest < 1e6) || (number == 0 && longest >= reach)) return false;
            for (int i = 0; i + 1 < N; ++i) at[i] -= off[i] * std::min(1.0, FAR / longest);
        }
        return false;
    }

    // Stability, energy and tip of a root.
    void describe(TorusRoot& root, double outermost, double step) const {
        State<N, N + 1> state = at_tips(root.psi.data());
        root.is_stable = true;
        const auto look = [&](const State<N, N + 1>& here, double back) {
            double A[N][N];
            for (int i = 0; i < N; ++i)
                for (int j = 0; j < N; ++j) A[i][j] = here.q[i][j + 1] + back * tubes_.behind[i] * here.v[i][j + 1];
            root.is_stable = root.is_stable && solve<N>(A, nullptr) > 0;
        };
        shoot(state, step, [&](const auto& here, double) { look(here, 0.0); });
        for (int k = 1; k <= COLLAR_STEPS; ++k) look(state, static_cast<double>(k) / COLLAR_STEPS);
        State<N, 1> q;
        root.energy = 0.0;
        const double turn = outermost - collar(state, 0);
        for (int i = 0; i < N; ++i) {
            q.q[i][0] = state.q[i][0] + turn;
            q.v[i][0] = state.v[i][0];
            root.energy -= tubes_.GJ[i] / 2 * state.v[i][0] * state.v[i][0] * tubes_.behind[i];
        }
        double R[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
        std::fill(root.tip, root.tip + 3, 0.0);
        for (const TorusStretch& part : tubes_.stretches) {
            const double length = part.end - part.begin;
            const int count = std::max(1, static_cast<int>(std::ceil(length / step * SHAPE_STEPS)));
            const double h = length / count;
            for (int k = 0; k < count; ++k) {
                advance(part, q, k * h, h / 2);
                root.energy += h * arc(part, q, (k + 0.5) * h, h, root.tip, R);
                advance(part, q, (k + 0.5) * h, h / 2);
            }
        }
    }

    int sign(const double* psi, double step) const {
        double R[P], by[P][P];
        State<N, N + 1> state = at_tips(psi);
        shoot(state, step, [](const auto&, double) {});
        relative(state, R, by);
        const double det = solve<P>(by, nullptr);
        return det > 0 ? 1 : det < 0 ? -1 : 0;
    }

    // Angles along the tubes [tube][K], beginning behind the plate; the arc lengths depend on the tubes alone.
    void lay_out(const double* psi, double outermost, double step, std::vector<double>& s, std::vector<double>& theta) const {
        State<N, N + 1> state = at_tips(psi);
        std::vector<double> along;  // [place][tube] from the tips on
        s.clear();
        const auto add = [&](double at, double behind) {
            s.push_back(at);
            for (int i = 0; i < N; ++i) along.push_back(state.q[i][0] + std::max(behind, tubes_.behind[i]) * state.v[i][0]);
        };
        add(tubes_.stretches.empty() ? 0.0 : tubes_.stretches.back().end, 0.0);
        State<N, N + 1> now = state;
        shoot(now, step, [&](const State<N, N + 1>& here, double at) {
            state = here;
            add(at, 0.0);
        });
        std::vector<double> held = tubes_.behind;
        std::sort(held.rbegin(), held.rend());
        for (double at : held)
            if (at < 0.0) add(at, at);
        const double turn = outermost - collar(state, 0);
        const std::size_t count = s.size();
        std::reverse(s.begin(), s.end());
        for (int i = 0; i < N; ++i)
            for (std::size_t k = 0; k < count; ++k) theta.push_back(along[(count - 1 - k) * N + i] + turn);
    }

  private:
    double collar(const State<N, N + 1>& state, int i) const { return state.q[i][0] + tubes_.behind[i] * state.v[i][0]; }

    // One where nothing twists anything: angles are linear there.
    static int steps(const TorusStretch& part, double step) {
        int bent = 0;
        bool varies = false;
        for (int i = 0; i < N; ++i) {
            bent += i >= part.first && (part.u[2 * i] != 0 || part.u[2 * i + 1] != 0);
            varies = varies || part.slope[2 * i] != 0 || part.slope[2 * i + 1] != 0;
        }
        return bent < 2 && !varies ? 1 : std::max(1, static_cast<int>(std::ceil((part.end - part.begin) / step)));
    }

    // Rotated precurvatures (N, 2) at `at` from the begin of the stretch; returns the sum of the bending stiffnesses there.
    template <int C>
    double precurvatures(const TorusStretch& part, const double (&q)[N][C], double at, double (&u)[N][2], double (&w)[N]) const {
        double total = 0.0;
        for (int i = 0; i < N; ++i) {
            w[i] = i >= part.first ? tubes_.EI[i] : 0.0;
            total += w[i];
            const double x = part.u[2 * i] + at * part.slope[2 * i], y = part.u[2 * i + 1] + at * part.slope[2 * i + 1];
            const double c = std::cos(q[i][0]), s = std::sin(q[i][0]);
            u[i][0] = c * x - s * y;
            u[i][1] = s * x + c * y;
        }
        return total;
    }

    // Second derivatives of the angles, and of their derivatives.
    template <int C>
    void bent(const TorusStretch& part, const double (&q)[N][C], double at, double (&a)[N][C]) const {
        double u[N][2], w[N];
        const double total = precurvatures(part, q, at, u, w);
        double sum[2] = {0.0, 0.0};
        for (int i = 0; i < N; ++i)
            for (int c = 0; c < 2; ++c) sum[c] += w[i] * u[i][c];
        for (int i = 0; i < N; ++i) {
            const double share = w[i] / (tubes_.GJ[i] * total);
            a[i][0] = -share * (u[i][0] * sum[1] - u[i][1] * sum[0]);
            if constexpr (C > 1) {
                double K[N], own = 0.0;
                for (int j = 0; j < N; ++j) {
                    const double dot = (u[i][0] * u[j][0] + u[i][1] * u[j][1]) * w[j];
                    K[j] = -share * dot;
                    if (j != i) own += dot;
                }
                K[i] = share * own;
                for (int c = 1; c < C; ++c) {
                    double value = 0.0;
                    for (int j = 0; j < N; ++j) value += K[j] * q[j][c];
                    a[i][c] = value;
                }
            }
        }
    }

    // A step of Nystroem's method of fourth order, from `at` by h.
    template <int C>
    void advance(const TorusStretch& part, State<N, C>& state, double at, double h) const {
        double a1[N][C], a2[N][C], a3[N][C], q[N][C];
        bent(part, state.q, at, a1);
        for (int i = 0; i < N; ++i)
            for (int c = 0; c < C; ++c) q[i][c] = state.q[i][c] + h / 2 * state.v[i][c] + h * h / 8 * a1[i][c];
        bent(part, q, at + h / 2, a2);
        for (int i = 0; i < N; ++i)
            for (int c = 0; c < C; ++c) q[i][c] = state.q[i][c] + h * state.v[i][c] + h * h / 2 * a2[i][c];
        bent(part, q, at + h, a3);
        for (int i = part.first; i < N; ++i)
            for (int c = 0; c < C; ++c) {
                state.q[i][c] += h * state.v[i][c] + h * h / 6 * (a1[i][c] + 2 * a2[i][c]);
                state.v[i][c] += h / 6 * (a1[i][c] + 4 * a2[i][c] + a3[i][c]);
            }
    }

    // Energy per length, and the backbone led on by an arc of the length h.
    double arc(const TorusStretch& part, const State<N, 1>& state, double at, double h, double* p, double (&R)[3][3]) const {
        double u[N][2], w[N], mean[2] = {0.0, 0.0}, energy = 0.0;
        const double total = precurvatures(part, state.q, at, u, w);
        for (int i = 0; i < N; ++i)
            for (int c = 0; c < 2; ++c) mean[c] += w[i] * u[i][c] / total;
        for (int i = 0; i < N; ++i) {
            const double x = u[i][0] - mean[0], y = u[i][1] - mean[1];
            energy += w[i] * (x * x + y * y) / 2 + (i >= part.first ? tubes_.GJ[i] * state.v[i][0] * state.v[i][0] / 2 : 0.0);
        }
        const double k = std::hypot(mean[0], mean[1]), angle = k * h;
        const double x = angle < FLAT ? 0.0 : mean[0] / k, y = angle < FLAT ? 0.0 : mean[1] / k;  // the axis
        const double s = std::sin(angle), c = std::cos(angle);
        const double turn[3][3] = {{1 - (1 - c) * y * y, (1 - c) * x * y, s * y},
                                   {(1 - c) * x * y, 1 - (1 - c) * x * x, -s * x},
                                   {-s * y, s * x, c}};
        const double side = angle < FLAT ? 0.0 : (1 - c) / k, along = angle < FLAT ? h : s / k;
        const double d[3] = {side * y, -side * x, along};
        double next[3][3];
        for (int i = 0; i < 3; ++i) {
            p[i] += R[i][0] * d[0] + R[i][1] * d[1] + R[i][2] * d[2];
            for (int j = 0; j < 3; ++j) next[i][j] = R[i][0] * turn[0][j] + R[i][1] * turn[1][j] + R[i][2] * turn[2][j];
        }
        std::copy(&next[0][0], &next[0][0] + 9, &R[0][0]);
        return energy;
    }

    const TorusTubes& tubes_;
};

// Calls work with the torus of the number of tubes that there are.
template <class Work>
auto with_torus(const TorusTubes& tubes, const Work& work) {
    switch (tubes.count()) {
        case 1: return work(Torus<1>(tubes));
        case 2: return work(Torus<2>(tubes));
        case 3: return work(Torus<3>(tubes));
        case 4: return work(Torus<4>(tubes));
        default: return work(Torus<5>(tubes));
    }
}

}  // namespace

std::vector<int> torus_signs(const TorusTubes& tubes, const std::vector<double>& psi, double step) {
    return with_torus(tubes, [&](const auto& torus) {
        const std::size_t pairs = tubes.EI.size() - 1, count = pairs == 0 ? 1 : psi.size() / pairs;
        std::vector<int> signs;
        for (std::size_t k = 0; k < count; ++k) signs.push_back(torus.sign(psi.data() + k * pairs, step));
        return signs;
    });
}

std::vector<std::vector<TorusRoot>> torus_roots(const TorusTubes& tubes, const std::vector<double>& psi, const std::vector<double>& alpha,
                                                const std::vector<double>& outermost, double reach, double apart, double step) {
    return with_torus(tubes, [&](const auto& torus) {
        const std::size_t pairs = tubes.EI.size() - 1, count = pairs == 0 ? 1 : psi.size() / pairs;
        std::vector<decltype(torus.begin(psi.data(), step))> starts;
        for (std::size_t k = 0; k < count; ++k) starts.push_back(torus.begin(psi.data() + k * pairs, step));
        std::vector<std::vector<TorusRoot>> all(outermost.size());
        for (std::size_t a = 0; a < all.size(); ++a)
            for (std::size_t k = 0; k < count; ++k) {
                TorusRoot root;
                if (!torus.find(psi.data() + k * pairs, starts[k], alpha.data() + a * pairs, reach, step, root)) continue;
                const bool is_known = std::any_of(all[a].begin(), all[a].end(), [&](const TorusRoot& other) {
                    double most = 0.0;
                    for (std::size_t i = 0; i < pairs; ++i) most = std::max(most, std::abs(turned(root.psi[i] - other.psi[i])));
                    return most <= apart;
                });
                if (is_known) continue;
                torus.describe(root, outermost[a], step);
                all[a].push_back(std::move(root));
            }
        return all;
    });
}

TorusShapes torus_shapes(const TorusTubes& tubes, const std::vector<double>& psi, const std::vector<double>& outermost, double step) {
    return with_torus(tubes, [&](const auto& torus) {
        const std::size_t pairs = tubes.EI.size() - 1;
        TorusShapes made;
        for (std::size_t k = 0; k < outermost.size(); ++k) torus.lay_out(psi.data() + k * pairs, outermost[k], step, made.s, made.theta);
        return made;
    });
}

}  // namespace ctr
