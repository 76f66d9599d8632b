// Gauss points of an element, and sines and cosines of the angles there: included inside an anonymous namespace by the
// solve of the zero-clearance system and by what reads its solution.

constexpr int kGaussPoints = 3;
constexpr double kPoint[kGaussPoints] = {0.11270166537925831148, 0.5, 0.88729833462074168852};

typedef double Two __attribute__((vector_size(16)));

// Sines and cosines of `count` angles, rounded up to a multiple of two; |x| < 1e6. Reduction by multiples of pi leaves one
// polynomial and a sign, the same for all, so that angles go through side by side.
inline void sines_cosines(const double* x, double* sine, double* cosine, int count) {
    for (int k = 0; k < count; k += 2) {
        Two angle;
        __builtin_memcpy(&angle, x + k, sizeof angle);
        const double shift = 6755399441055744.0;  // 1.5 * 2^52: adding it rounds to an integer
        const Two turns = (angle * 0.31830988618379067154 + shift) - shift;
        const Two halves = (turns * 0.5 + shift) - shift, odd = turns - 2.0 * halves;  // -1, 0 or 1
        const Two sign = 1.0 - 2.0 * odd * odd;
        const Two r = (angle - turns * 3.14159265346825122834) - turns * 1.21542010130123844986e-10;
        const Two z = r * r;
        Two s = z * (1.0 / 51090942171709440000.0) - 1.0 / 121645100408832000.0;
        s = s * z + 1.0 / 355687428096000.0;
        s = s * z - 1.0 / 1307674368000.0;
        s = s * z + 1.0 / 6227020800.0;
        s = s * z - 1.0 / 39916800.0;
        s = s * z + 1.0 / 362880.0;
        s = s * z - 1.0 / 5040.0;
        s = s * z + 1.0 / 120.0;
        s = s * z - 1.0 / 6.0;
        s = sign * (r + r * z * s);
        Two c = 1.0 / 6402373705728000.0 - z * (1.0 / 2432902008176640000.0 - z * (1.0 / 1124000727777607680000.0));
        c = 1.0 / 20922789888000.0 - z * c;
        c = 1.0 / 87178291200.0 - z * c;
        c = 1.0 / 479001600.0 - z * c;
        c = 1.0 / 3628800.0 - z * c;
        c = 1.0 / 40320.0 - z * c;
        c = 1.0 / 720.0 - z * c;
        c = 1.0 / 24.0 - z * c;
        c = 0.5 - z * c;
        c = sign * (1.0 - z * c);
        __builtin_memcpy(sine + k, &s, sizeof s);
        __builtin_memcpy(cosine + k, &c, sizeof c);
    }
}
