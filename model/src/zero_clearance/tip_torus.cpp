#include "ctr/tip_torus.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <utility>

namespace ctr {
namespace {

constexpr int NEWTON = 20;               // steps
constexpr int COARSE = 3;                // times the steps of integrations that only tell where to go
constexpr double NEAR = 0.02;            // a step [rad] after which integrations are fine: coarse ones err by 1e-4
constexpr double FAR = 0.6;              // the longest of a step [rad]
constexpr double HALF = 0.5;              // of a contraction, as Kantorovich's theorem asks for
constexpr double SETTLED = 1e-9;         // of R [rad]
constexpr int COLLAR_STEPS = 8;          // behind the plate, where conjugate points are looked for
constexpr int SHAPE_STEPS = 2;           // of the shape, for a step from the tips: its backbone is of second order
constexpr double FARTHEST = 1e6;          // a step [rad] that says nothing
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
class TorusOf : public TipTorus {
  public:
    TorusOf(TorusTubes tubes, double step) : tubes_(std::move(tubes)), step_(step) {}

    TorusMap map(int count) override {
        TorusMap made;
        for (const Place& place : grid(count)) {
            made.R.insert(made.R.end(), place.R, place.R + N - 1);
            made.det.push_back(place.det);
        }
        return made;
    }

    std::vector<std::vector<TorusRoot>> roots(int count, const std::vector<double>& alpha, const std::vector<double>& outermost,
                                              double reach, double apart) override {
        const std::vector<Place>& places = grid(count);
        std::vector<Place> earlier, known;  // roots for other alpha: the next one is near, often
        std::vector<std::pair<double, const Place*>> order;  // what leads there by the shortest step goes first
        std::vector<std::vector<TorusRoot>> all(outermost.size());
        for (std::size_t a = 0; a < all.size(); ++a) {
            const double* here = alpha.data() + a * (N - 1);
            double by[P];
            order.clear();
            known.clear();
            for (const std::vector<Place>* some : {&places, &std::as_const(earlier)})
                for (const Place& place : *some)
                    if (const double length = step_to(here, place, by); length < reach) order.emplace_back(length, &place);
            std::stable_sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
            for (const auto& [length, begun] : order) {
                Place place = *begun;
                if (!find(place, here, reach, known)) continue;
                if (std::any_of(known.begin(), known.end(), [&](const Place& root) { return distance(place, root) <= apart; })) continue;
                known.push_back(place);
                all[a].push_back(describe(place, outermost[a]));
            }
            earlier.insert(earlier.end(), known.begin(), known.end());
        }
        return all;
    }

    TorusShapes shapes(const std::vector<double>& psi, const std::vector<double>& outermost) const override {
        TorusShapes made;
        for (std::size_t k = 0; k < outermost.size(); ++k) lay_out(psi.data() + k * (N - 1), outermost[k], made.s, made.theta);
        return made;
    }

  private:
    static constexpr int P = N > 1 ? N - 1 : 1;  // pairs, one that stands still beside a single tube

    // Angles at the tips, and where they lead to, which is the same whatever collars are asked for.
    struct Place {
        double psi[P] = {}, R[P], by[P][P], back[P][P];  // back: the inverse of by
        double det;                                      // of by; 0 where there is no inverse
    };

    // All places of so many angles along each pair, evenly over the torus.
    const std::vector<Place>& grid(int count) {
        std::vector<Place>& places = grids_[count];
        if (!places.empty()) return places;
        std::size_t total = 1;
        for (int i = 0; i + 1 < N; ++i) total *= count;
        for (std::size_t k = 0; k < total; ++k) {
            double psi[P] = {};
            std::size_t left = k;
            for (int i = N - 2; i >= 0; --i, left /= count) psi[i] = WHOLE * static_cast<double>(left % count) / count;
            places.push_back(at(psi, COARSE * step_));
        }
        return places;
    }

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

    Place at(const double (&psi)[P], double step) const {
        Place made;
        std::copy(psi, psi + P, made.psi);
        State<N, N + 1> state = at_tips(psi);
        shoot(state, step, [](const auto&, double) {});
        relative(state, made.R, made.by);
        double det = 1.0;
        for (int j = 0; j < P && det != 0.0; ++j) {
            double copy[P][P], column[P] = {};
            column[j] = 1.0;
            std::copy(&made.by[0][0], &made.by[0][0] + P * P, &copy[0][0]);
            det = solve<P>(copy, column);
            for (int i = 0; i < P; ++i) made.back[i][j] = column[i];
        }
        made.det = det;
        return made;
    }

    static double distance(const Place& a, const Place& b) {
        double most = 0.0;
        for (int i = 0; i < P; ++i) most = std::max(most, std::abs(turned(a.psi[i] - b.psi[i])));
        return most;
    }

    // Newton's step by derivatives at a place, for what lacks to alpha where R is reached; its largest part.
    static double step_by(const Place& place, const double (&R)[P], const double* alpha, double (&by)[P]) {
        double off[P] = {}, longest = 0.0;
        for (int i = 0; i + 1 < N; ++i) off[i] = turned(alpha[i] - R[i]);
        for (int i = 0; i < P; ++i) {
            by[i] = 0.0;
            for (int j = 0; j < P; ++j) by[i] += place.back[i][j] * off[j];
            longest = std::max(longest, std::abs(by[i]));
        }
        return longest;
    }

    // From a place towards alpha; infinite where it leads nowhere.
    static double step_to(const double* alpha, const Place& place, double (&by)[P]) {
        const double longest = place.det != 0 ? step_by(place, place.R, alpha, by) : FARTHEST;
        return longest < FARTHEST ? longest : std::numeric_limits<double>::infinity();
    }

    // Whether Newton's method ends at a root that is known: the step leads half of the way there at least, and derivatives
    // differ by less than half, both of which Kantorovich's theorem asks for.
    static bool leads_to(const Place& root, const Place& place, const double (&by)[P]) {
        double left = 0.0;
        for (int i = 0; i < P; ++i) left = std::max(left, std::abs(turned(root.psi[i] - place.psi[i]) - by[i]));
        if (left > HALF * distance(root, place)) return false;
        for (int i = 0; i < P; ++i) {
            double differs = 0.0;
            for (int j = 0; j < P; ++j) {
                double value = i == j ? -1.0 : 0.0;
                for (int k = 0; k < P; ++k) value += root.back[i][k] * place.by[k][j];
                differs += std::abs(value);
            }
            if (differs > HALF) return false;
        }
        return true;
    }

    // Newton's method from a place to a root that is none of those known. It gives up where it leaves the place's
    // neighbourhood, whose roots are for others to find, and where what lacks, by the same derivatives, does not shrink as a
    // step of that share has it (Deuflhard's natural monotonicity; the first step's derivatives are those of the grid).
    bool find(Place& place, const double* alpha, double reach, const std::vector<Place>& known) const {
        const Place begun = place;
        double by[P], left[P];
        bool is_fine = false;
        for (int number = 0; number < NEWTON; ++number) {
            const double longest = step_to(alpha, place, by);
            double most = 0.0;
            for (int i = 0; i + 1 < N; ++i) most = std::max(most, std::abs(turned(place.R[i] - alpha[i])));
            if (is_fine && most < SETTLED) return true;
            if (!std::isfinite(longest)) return false;
            if (std::any_of(known.begin(), known.end(), [&](const Place& root) { return leads_to(root, place, by); })) return false;
            const double share = std::min(1.0, FAR / longest);
            double next[P], away = 0.0;
            for (int i = 0; i < P; ++i) {
                next[i] = place.psi[i] + by[i] * share;
                away = std::max(away, std::abs(next[i] - begun.psi[i]));
            }
            if (away >= reach) return false;
            is_fine = longest <= NEAR;
            const Place then = at(next, is_fine ? step_ : COARSE * step_);
            if (number > 0 && !is_fine && step_by(place, then.R, alpha, left) > (1 - share / 2) * longest) return false;
            place = then;
        }
        return false;
    }

    // Stability, energy and tip of a root.
    TorusRoot describe(const Place& place, double outermost) const {
        TorusRoot root;
        root.psi.assign(place.psi, place.psi + N - 1);
        for (int i = 0; i + 1 < N; ++i) root.twist.push_back(place.R[i] - place.psi[i]);
        root.sign = place.det > 0 ? 1 : place.det < 0 ? -1 : 0;
        root.is_stable = true;
        State<N, N + 1> state = at_tips(place.psi);
        const auto look = [&](const State<N, N + 1>& here, double back) {
            double A[N][N];
            for (int i = 0; i < N; ++i)
                for (int j = 0; j < N; ++j) A[i][j] = here.q[i][j + 1] + back * tubes_.behind[i] * here.v[i][j + 1];
            root.is_stable = root.is_stable && solve<N>(A, nullptr) > 0;
        };
        shoot(state, step_, [&](const auto& here, double) { look(here, 0.0); });
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
            const int count = std::max(1, static_cast<int>(std::ceil(length / step_ * SHAPE_STEPS)));
            const double h = length / count;
            for (int k = 0; k < count; ++k) {
                advance(part, q, k * h, h / 2);
                root.energy += h * arc(part, q, (k + 0.5) * h, h, root.tip, R);
                advance(part, q, (k + 0.5) * h, h / 2);
            }
        }
        return root;
    }

    // Angles along the tubes [tube][K], beginning behind the plate; the arc lengths depend on the tubes alone.
    void lay_out(const double* psi, double outermost, std::vector<double>& s, std::vector<double>& theta) const {
        State<N, N + 1> state = at_tips(psi);
        std::vector<double> along;  // [place][tube] from the tips on
        s.clear();
        const auto add = [&](double at, double behind) {
            s.push_back(at);
            for (int i = 0; i < N; ++i) along.push_back(state.q[i][0] + std::max(behind, tubes_.behind[i]) * state.v[i][0]);
        };
        add(tubes_.stretches.empty() ? 0.0 : tubes_.stretches.back().end, 0.0);
        State<N, N + 1> now = state;
        shoot(now, step_, [&](const State<N, N + 1>& here, double at) {
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

    const TorusTubes tubes_;
    const double step_;
    std::map<int, std::vector<Place>> grids_;  // by their counts; those of five tubes may take 0.1 GB
};

}  // namespace

std::unique_ptr<TipTorus> TipTorus::of(TorusTubes tubes, double step) {
    switch (tubes.count()) {
        case 1: return std::make_unique<TorusOf<1>>(std::move(tubes), step);
        case 2: return std::make_unique<TorusOf<2>>(std::move(tubes), step);
        case 3: return std::make_unique<TorusOf<3>>(std::move(tubes), step);
        case 4: return std::make_unique<TorusOf<4>>(std::move(tubes), step);
        default: return std::make_unique<TorusOf<5>>(std::move(tubes), step);
    }
}

}  // namespace ctr
