// One gradient step of DQN, Double DQN and Dueling Double DQN on the Nature network, in float32 on
// one thread. The reference is agents.Learner, in PyTorch, to which tests hold this file; what is
// here beside speed is explained where it stands.
//
// Three ideas make it fast.
//   1. Cook-Toom ("Winograd") convolutions (Lavin and Gray, 2016): a tile of outputs is computed by
//      transforming the tile's inputs and the filter to a few points, multiplying there, and
//      transforming back, which needs 2.3 to 3.1 times fewer multiplications than the convolution.
//   2. The convolutions 8x8 with stride 4 and 4x4 with stride 2 are 2x2 with stride 1 on blocks of
//      4x4 pixels and 2x2 positions ("space to depth"), so that the above serves all three.
//   3. Features that are zero in the whole batch are left out, exactly, and so are hidden units
//      without a gradient; Adam updates the hidden layer while its gradient is in the cache.
//
// And one rule makes it exact: every float operation and its order is written down. Multiply-adds
// are fused where this file says so and nowhere else (-ffp-contract=off, -fno-fast-math), and no
// function whose rounding is not specified is called. A product sums over k = 0, 1, 2, ... in this
// order, however its loops are blocked. Hence the same bits from any compiler on any processor
// with AVX2 and FMA, with or without AVX-512, and for an observation alone or within a batch, while
// weights are finite.
//
// Letters: B batch, S frame stack, A actions, K input channels, N output channels, T tiles.

#include <immintrin.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <initializer_list>
#include <new>

#ifdef __FAST_MATH__
#error "needs exact floating-point arithmetic: -fno-fast-math"
#endif

#define INLINE static inline __attribute__((always_inline))

// ---- 16 floats at once: a register of AVX-512, or two of AVX2 -------------------------------------
//
// Both give the same bits: each of the 16 is computed by itself, as IEEE 754 says.

constexpr int LANES = 16;

#ifdef __AVX512F__
constexpr int MOST_ROWS = 12;  // of a product, whose sums then fill half of the 32 registers

struct Lanes {
  __m512 x;
};
INLINE Lanes zero() { return {_mm512_setzero_ps()}; }
INLINE Lanes splat(float a) { return {_mm512_set1_ps(a)}; }
INLINE Lanes load(const float* p) { return {_mm512_loadu_ps(p)}; }
INLINE Lanes load(const uint8_t* p) {
  return {_mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128((const __m128i*)p)))};
}
INLINE void store(float* p, Lanes a) { _mm512_storeu_ps(p, a.x); }
INLINE Lanes operator+(Lanes a, Lanes b) { return {_mm512_add_ps(a.x, b.x)}; }
INLINE Lanes operator-(Lanes a, Lanes b) { return {_mm512_sub_ps(a.x, b.x)}; }
INLINE Lanes operator*(Lanes a, Lanes b) { return {_mm512_mul_ps(a.x, b.x)}; }
INLINE Lanes operator/(Lanes a, Lanes b) { return {_mm512_div_ps(a.x, b.x)}; }
INLINE Lanes fma(Lanes a, Lanes b, Lanes c) { return {_mm512_fmadd_ps(a.x, b.x, c.x)}; }
INLINE Lanes root(Lanes a) { return {_mm512_sqrt_ps(a.x)}; }
INLINE Lanes relu(Lanes a) {  // the order of the arguments lets NaN through
  return {_mm512_max_ps(_mm512_setzero_ps(), a.x)};
}
INLINE Lanes where_positive(Lanes y, Lanes a) {  // a where y > 0, else 0
  return {_mm512_maskz_mov_ps(_mm512_cmp_ps_mask(y.x, _mm512_setzero_ps(), _CMP_GT_OQ), a.x)};
}
INLINE unsigned nonzero(Lanes a) {  // a bit for each of the 16
  return _mm512_cmp_ps_mask(a.x, _mm512_setzero_ps(), _CMP_NEQ_UQ);
}
#else
constexpr int MOST_ROWS = 6;  // of a product, which then fills 12 of the 16 registers

struct Lanes {
  __m256 x, y;
};
INLINE Lanes zero() { return {_mm256_setzero_ps(), _mm256_setzero_ps()}; }
INLINE Lanes splat(float a) { return {_mm256_set1_ps(a), _mm256_set1_ps(a)}; }
INLINE Lanes load(const float* p) { return {_mm256_loadu_ps(p), _mm256_loadu_ps(p + 8)}; }
INLINE Lanes load(const uint8_t* p) {
  const auto eight = [](const uint8_t* q) {
    return _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)q)));
  };
  return {eight(p), eight(p + 8)};
}
INLINE void store(float* p, Lanes a) { _mm256_storeu_ps(p, a.x), _mm256_storeu_ps(p + 8, a.y); }
#define BY_ELEMENT(name, f)                                                              \
  INLINE Lanes name(Lanes a, Lanes b) { return {f(a.x, b.x), f(a.y, b.y)}; }
BY_ELEMENT(operator+, _mm256_add_ps)
BY_ELEMENT(operator-, _mm256_sub_ps)
BY_ELEMENT(operator*, _mm256_mul_ps)
BY_ELEMENT(operator/, _mm256_div_ps)
INLINE Lanes fma(Lanes a, Lanes b, Lanes c) {
  return {_mm256_fmadd_ps(a.x, b.x, c.x), _mm256_fmadd_ps(a.y, b.y, c.y)};
}
INLINE Lanes root(Lanes a) { return {_mm256_sqrt_ps(a.x), _mm256_sqrt_ps(a.y)}; }
INLINE Lanes relu(Lanes a) {  // the order of the arguments lets NaN through
  return {_mm256_max_ps(_mm256_setzero_ps(), a.x), _mm256_max_ps(_mm256_setzero_ps(), a.y)};
}
INLINE __m256 positive(__m256 a) { return _mm256_cmp_ps(a, _mm256_setzero_ps(), _CMP_GT_OQ); }
INLINE Lanes where_positive(Lanes y, Lanes a) {  // a where y > 0, else 0
  return {_mm256_and_ps(a.x, positive(y.x)), _mm256_and_ps(a.y, positive(y.y))};
}
INLINE unsigned nonzero(Lanes a) {  // a bit for each of the 16
  const __m256 none = _mm256_setzero_ps();
  return _mm256_movemask_ps(_mm256_cmp_ps(a.x, none, _CMP_NEQ_UQ)) |
         _mm256_movemask_ps(_mm256_cmp_ps(a.y, none, _CMP_NEQ_UQ)) << 8;
}
#endif

// Denormal numbers count as zero, as in the PyTorch learner: Adam's dying moments would be slow.
struct FlushDenormals {
  unsigned before = _mm_getcsr();
  FlushDenormals() { _mm_setcsr(0x1f80 | 0x8040); }  // all exceptions masked, to nearest | FTZ, DAZ
  ~FlushDenormals() { _mm_setcsr(before); }
};

template <class X> struct Buffer {  // memory that grows when more is wanted; its contents are lost
  X* data = nullptr;
  long size = 0;
  X* want(long n) {
    if (n > size) {
      std::free(data);
      data = (X*)std::aligned_alloc(4096, (n * sizeof(X) + 4095) / 4096 * 4096);
      size = data ? n : 0;
      if (!data) throw std::bad_alloc();
    }
    return data;
  }
  Buffer() = default;
  Buffer(const Buffer&) = delete;
  ~Buffer() { std::free(data); }
};

// ---- Matrix products ----------------------------------------------------------------------------

// Where element number i of a sequence is: at equal distances, or in a list of places.
struct Stride {
  static constexpr bool EVEN = true;
  long by;
  long operator()(int i) const { return i * by; }
};
struct Places {
  static constexpr bool EVEN = false;
  const int* places;
  long operator()(int i) const { return places[i]; }
};
template <class Sequence> struct From {  // a sequence from its element number `first` on
  static constexpr bool EVEN = Sequence::EVEN;
  Sequence all;
  int first;
  long operator()(int i) const { return all(first + i); }
};

// C[R][16] = (add ? C : 0) + sum_k A[R][k] B[k][16]; element k of A's row i is A[row(i) + ka(k)],
// row k of B begins at B[kb(k)], and row i of C at C[i * ldc].
template <int R, class Row, class KA, class KB>
INLINE void product_rows(int K, const float* A, Row row, KA ka, const float* B, KB kb, float* C,
                         long ldc, bool add) {
  Lanes c[R];
  const float* a[R];
#pragma GCC unroll 16
  for (int i = 0; i < R; i++) c[i] = add ? load(C + i * ldc) : zero(), a[i] = A + row(i);
  const long by = Row::EVEN ? row(1) - row(0) : 0;
  for (int k = 0; k < K; k++) {
    const Lanes b = load(B + kb(k));
    // rows at equal distances are reached from every third: else there are too few registers
    const long at = ka(k), next[] = {at, at + by, at + 2 * by};
#pragma GCC unroll 16
    for (int i = 0; i < R; i++)
      c[i] = fma(splat(Row::EVEN ? a[i / 3 * 3][next[i % 3]] : a[i][at]), b, c[i]);
  }
#pragma GCC unroll 16
  for (int i = 0; i < R; i++) store(C + i * ldc, c[i]);
}

template <int R, class Row, class KA, class KB>
INLINE void choose_rows(int rows, int K, const float* A, Row row, KA ka, const float* B, KB kb,
                        float* C, long ldc, bool add) {
  if (rows == R) product_rows<R>(K, A, row, ka, B, kb, C, ldc, add);
  else if constexpr (R > 1) choose_rows<R - 1>(rows, K, A, row, ka, B, kb, C, ldc, add);
}

// The same for M rows, in blocks of 256 k, whose part of B stays in the first cache.
template <class Row, class KA, class KB>
static void product(int M, int K, const float* A, Row row, KA ka, const float* B, KB kb, float* C,
                    long ldc, bool add = false) {
  const int blocks = (M + MOST_ROWS - 1) / MOST_ROWS;
  for (int k = 0; k == 0 || k < K; k += 256) {
    const int some = K - k < 256 ? K - k : 256;
    for (int block = 0, first = 0; block < blocks; block++) {
      const int rows = M / blocks + (block < M % blocks);
      choose_rows<MOST_ROWS>(
          rows, some, A, From<Row>{row, first}, From<KA>{ka, k}, B, From<KB>{kb, k},
          C + first * ldc, ldc, add || k > 0);
      first += rows;
    }
  }
}

// ---- Cook-Toom convolution ----------------------------------------------------------------------
//
// F(m, r): m outputs y_i = sum_k g_k d_{i+k} of a filter of r taps are the coefficients of a product
// of polynomials, transposed. A polynomial of degree n - 1, n = m + r - 1, is fixed by its values at
// n - 1 points and its leading coefficient (the "point at infinity"). Evaluation, product and
// interpolation, transposed (Toom, 1963; Winograd, 1980), give
//     y = A ((G g) * (Bt d)),   A[m][n], G[n][r], Bt[n][n], * by element,
// and in two dimensions  Y = A ((G g G') * (Bt d Bt')) A'.

template <int R, int C> struct Matrix {
  float x[R][C];
  constexpr Matrix<C, R> transposed() const {
    Matrix<C, R> t{};
    for (int i = 0; i < R; i++)
      for (int j = 0; j < C; j++) t.x[j][i] = x[i][j];
    return t;
  }
};

template <int m, int r> struct CookToom {
  static constexpr int n = m + r - 1;
  Matrix<m, n> A{};
  Matrix<n, r> G{};
  Matrix<n, n> Bt{};
  constexpr CookToom(std::array<double, n - 1> points) {
    for (int j = 0; j < n; j++) {
      // the polynomial with the other points for its roots, and its value at point j
      std::array<double, n> poly{1};
      double value = 1;
      for (int l = 0, degree = 0; l < n - 1; l++) {
        if (l == j) continue;
        degree++;
        for (int i = degree; i >= 0; i--) poly[i] = (i ? poly[i - 1] : 0) - points[l] * poly[i];
        if (j < n - 1) value *= points[j] - points[l];
      }
      for (int i = 0; i < n; i++) Bt.x[j][i] = (float)poly[i];
      double power = 1;
      for (int i = 0; i < (m > r ? m : r); i++) {
        const bool infinite = j == n - 1;
        if (i < m) A.x[i][j] = (float)(infinite ? i == m - 1 : power);
        if (i < r) G.x[j][i] = (float)(infinite ? i == r - 1 : power / value);
        if (!infinite) power *= points[j];
      }
    }
  }
};

constexpr CookToom<4, 2> F42({0, 1, -1, 2});
constexpr CookToom<3, 2> F32({0, 1, -1});
constexpr CookToom<4, 3> F43({0, 1, -1, 2, -0.5});

template <int m, int r> constexpr const CookToom<m, r>& cook_toom() {
  if constexpr (m == 4 && r == 2) return F42;
  else if constexpr (m == 3) return F32;
  else return F43;
}
template <int m, int r> struct Transforms {  // constants of their own, to be template arguments
  static constexpr auto A = cook_toom<m, r>().A;
  static constexpr auto G = cook_toom<m, r>().G;
  static constexpr auto Bt = cook_toom<m, r>().Bt;
  static constexpr auto At = cook_toom<m, r>().A.transposed();
  static constexpr auto Gt = cook_toom<m, r>().G.transposed();
  static constexpr auto B = cook_toom<m, r>().Bt.transposed();
};

// sum over c of M[r][c] in[c], without the zeros
template <const auto& M, int r, int C, int c = 0, bool begun = false>
INLINE Lanes row_times(const Lanes* in, Lanes sum = zero()) {
  if constexpr (c == C) return sum;
  else {
    constexpr float f = M.x[r][c];
    if constexpr (f == 0) return row_times<M, r, C, c + 1, begun>(in, sum);
    else if constexpr (f == 1)
      return row_times<M, r, C, c + 1, true>(in, begun ? sum + in[c] : in[c]);
    else if constexpr (f == -1 && begun) return row_times<M, r, C, c + 1, true>(in, sum - in[c]);
    else
      return row_times<M, r, C, c + 1, true>(
          in, begun ? fma(splat(f), in[c], sum) : splat(f) * in[c]);
  }
}
template <const auto& M, int R, int C, int r = 0>
INLINE void times(Lanes* out, int stride, const Lanes* in) {  // out = M in
  if constexpr (r < R) {
    out[r * stride] = row_times<M, r, C>(in);
    times<M, R, C, r + 1>(out, stride, in);
  }
}

// Y[R][R] = M X[C][C] M', on 16 channels at once; load_x(i, j) gives X, store_y(i, j, y) takes Y.
template <const auto& M, int R, int C, class Load, class Store>
INLINE void both_sides(Load load_x, Store store_y) {
  Lanes half[R * C];
#pragma GCC unroll 8
  for (int j = 0; j < C; j++) {
    Lanes column[C];
#pragma GCC unroll 8
    for (int i = 0; i < C; i++) column[i] = load_x(i, j);
    times<M, R, C>(half + j, C, column);
  }
#pragma GCC unroll 8
  for (int i = 0; i < R; i++) {
    Lanes row[R];
    times<M, R, C>(row, 1, half + i * C);
#pragma GCC unroll 8
    for (int j = 0; j < R; j++) store_y(i, j, row[j]);
  }
}

// Tiles of a batch are numbered image by image, row by row. This is all of them, once each:
struct EveryTile {
  int count;
  int first(int t) const { return t; }
  int next(int) const { return -1; }
};

// A convolution r x r with stride 1 of [IN][IN][K] to [OUT][OUT][N], in tiles of m x m outputs.
// Its weights are W[r*r][K][N]; in the transformed domain U[P][N/16][K][16] ("panels"), and for the
// gradient to the input UT[P][K/16][N][16]. Tiles are worked on in groups of T <= GROUP, so that
// V[P][T][K] (inputs), M[P][T][N] (outputs) and D[P][T][N] (gradients) stay in the second cache.
template <int m, int r, int IN, int OUT, int N, int GROUP> struct Convolution {
  using F = Transforms<m, r>;
  static constexpr int n = m + r - 1, P = n * n, SIDE = (OUT + m - 1) / m, TILES = SIDE * SIDE;
  static constexpr bool EXACT = SIDE * m == OUT;  // else the last tiles reach over the border
  static constexpr long OUTPUTS = (long)OUT * OUT * N;

  struct Place {
    int image, y, x;
    explicit Place(int tile)
        : image(tile / TILES), y(tile % TILES / SIDE * m), x(tile % SIDE * m) {}
    long output() const { return image * OUTPUTS + (y * OUT + x) * N; }
    bool has_output(int i, int j) const { return EXACT || (y + i < OUT && x + j < OUT); }
    bool has_input(int i, int j) const { return EXACT || (y + i < IN && x + j < IN); }
  };
  static int group(int tiles, int from) { return tiles - from < GROUP ? tiles - from : GROUP; }
  static long kept(int tiles, int K) { return (long)P * tiles * K; }  // floats of V

  static void transform_weights(const float* W, int K, float scale, float* U, int columns = N) {
    const long size = (long)K * columns;
    for (int k = 0; k < K; k++)
      for (int o = 0; o < columns; o += LANES) {
        float* to = U + (long)o * K + k * LANES;
        both_sides<F::G, n, r>(
            [&](int i, int j) {
              return splat(scale) * load(W + ((i * r + j) * K + k) * (long)columns + o);
            },
            [&](int i, int j, Lanes u) { store(to + (i * n + j) * size, u); });
      }
  }

  // at(image, y, x, k): where the 16 channels from k on of the input's position y, x are
  template <class Tiles, class In>
  static void transform_input(Tiles tiles, int from, int T, In at, int K, float* V) {
    for (int t = 0; t < T; t++) {
      const Place place(tiles.first(from + t));
      for (int k = 0; k < K; k += LANES) {
        float* to = V + (long)t * K + k;
        both_sides<F::Bt, n, n>(
            [&](int i, int j) {
              if (!place.has_input(i, j)) return zero();
              return load(at(place.image, place.y + i, place.x + j, k));
            },
            [&](int i, int j, Lanes v) { store(to + (i * n + j) * (long)T * K, v); });
      }
    }
  }

  // C[P][T][columns] = A[P][T][K] times panels
  static void multiply(const float* A, int T, int K, const float* panels, int columns, float* C) {
    for (int p = 0; p < P; p++)
      for (int o = 0; o < columns; o += LANES)
        product(T, K, A + (long)p * T * K, Stride{K}, Stride{1},
                panels + (long)p * K * columns + (long)o * K, Stride{LANES},
                C + (long)p * T * columns + o, columns);
  }

  template <class Tiles>
  static void transform_output(Tiles tiles, int from, int T, const float* M, const float* bias,
                               float* Y) {
    for (int t = 0; t < T; t++) {
      const int tile = tiles.first(from + t);
      const Place place(tile);
      float* own = Y + place.output();
      for (int o = 0; o < N; o += LANES) {
        const float* of = M + (long)t * N + o;
        const Lanes b = load(bias + o);
        both_sides<F::A, m, n>(
            [&](int i, int j) { return load(of + (i * n + j) * (long)T * N); },
            [&](int i, int j, Lanes y) {
              if (place.has_output(i, j)) store(own + (i * OUT + j) * N + o, relu(y + b));
            });
      }
      for (int other = tiles.next(tile); other >= 0; other = tiles.next(other))
        for (int i = 0; i < m; i++)
          std::memcpy(Y + Place(other).output() + i * OUT * N, own + i * OUT * N,
                      m * N * sizeof(float));
    }
  }

  struct Filters {
    const float *U, *bias;
    float* Y;
  };
  // Y = relu(convolution + bias), by each of `filters`; V is kept if it is for all tiles.
  template <class Tiles, class In>
  static void forward(Tiles tiles, In at, int K, std::initializer_list<Filters> filters, float* V,
                      bool keep, float* M) {
    for (int from = 0; from < tiles.count; from += GROUP) {
      const int T = group(tiles.count, from);
      float* own = V + (keep ? kept(from, K) : 0);
      transform_input(tiles, from, T, at, K, own);
      for (const Filters& f : filters) {
        multiply(own, T, K, f.U, N, M);
        transform_output(tiles, from, T, M, f.bias, f.Y);
      }
    }
  }

  // Gradients of weights (dW) and bias (db) and, if UT is given, of the input, which must be zero
  // before. V is what `forward` kept; dY, the gradient of Y, is set to zero where Y is.
  template <class Tiles, class In, class Out>
  static void backward(Tiles tiles, int B, In at, int K, float scale, const float* V,
                       const float* Y, float* dY, float* dW, float* db, const float* UT, Out dX_at,
                       float* D, float* dV, float* dU) {
    for (long i = 0; i < B * OUTPUTS; i += LANES)
      store(dY + i, where_positive(load(Y + i), load(dY + i)));
    for (int from = 0; from < tiles.count; from += GROUP) {
      const int T = group(tiles.count, from);
      transform_gradient(tiles, from, T, dY, D, db);
      const float* own = V + kept(from, K);
      for (int p = 0; p < P; p++)
        for (int o = 0; o < N; o += LANES)
          product(K, T, own + (long)p * T * K, Stride{1}, Stride{K}, D + (long)p * T * N + o,
                  Stride{N}, dU + (long)p * K * N + o, N, from > 0);
      if (UT) {
        multiply(D, T, N, UT, K, dV);
        transform_input_gradient(tiles, from, T, dV, K, dX_at);
      }
    }
    transform_weight_gradient(dU, K, scale, dW);
    Touched touched(K);
    for (int b = 0; b < B; b++) {
      touched.image(at, b, dY + b * OUTPUTS);
      if (UT) Touched::clear_input(dY + b * OUTPUTS, b, K, dX_at);
    }
    touched.clear_weights(dW);
  }

  // The gradient to a tile's outputs is the sum of those at all places where the tile is.
  template <class Tiles>
  static void transform_gradient(Tiles tiles, int from, int T, const float* dY, float* D,
                                 float* db) {
    for (int t = 0; t < T; t++) {
      const int tile = tiles.first(from + t);
      const Place place(tile);
      for (int o = 0; o < N; o += LANES) {
        Lanes bias = load(db + o);
        both_sides<F::At, n, m>(
            [&](int i, int j) {
              if (!place.has_output(i, j)) return zero();
              const long at = (i * OUT + j) * N + o;
              Lanes sum = load(dY + place.output() + at);
              for (int other = tiles.next(tile); other >= 0; other = tiles.next(other))
                sum = sum + load(dY + Place(other).output() + at);
              bias = bias + sum;
              return sum;
            },
            [&](int i, int j, Lanes d) {
              store(D + (long)t * N + o + (i * n + j) * (long)T * N, d);
            });
        store(db + o, bias);
      }
    }
  }

  template <class Tiles, class Out>
  static void transform_input_gradient(Tiles tiles, int from, int T, const float* dV, int K,
                                       Out dX_at) {
    for (int t = 0; t < T; t++) {
      const Place place(tiles.first(from + t));
      for (int k = 0; k < K; k += LANES) {
        const float* of = dV + (long)t * K + k;
        both_sides<F::B, n, n>(
            [&](int i, int j) { return load(of + (i * n + j) * (long)T * K); },
            [&](int i, int j, Lanes d) {
              if (!place.has_input(i, j)) return;
              float* to = dX_at(place.image, place.y + i, place.x + j, k);
              store(to, load(to) + d);
            });
      }
    }
  }

  static void transform_weight_gradient(const float* dU, int K, float scale, float* dW) {
    for (int k = 0; k < K; k++)
      for (int o = 0; o < N; o += LANES)
        both_sides<F::Gt, r, n>(
            [&](int i, int j) { return load(dU + ((long)(i * n + j) * K + k) * N + o); },
            [&](int i, int j, Lanes w) {
              store(dW + ((i * r + j) * K + k) * (long)N + o, splat(scale) * w);
            });
  }

  // A gradient that is a sum of zeros only, such as that of a weight that meets nothing but black
  // pixels wherever its filter is active, must be zero: the transforms leave a rounding error
  // there, of which Adam makes a step if its epsilon is small. `Touched` finds these weights (a
  // bit each) and positions of the input.
  struct Touched {
    static constexpr int MOST = r * r * 8;  // K <= 128
    int words;                              // of 16 channels a position
    uint64_t open = ~0ull >> (64 - N);      // filters of which not every weight is touched yet
    uint16_t seen[N][MOST] = {};
    explicit Touched(int K) : words(K / LANES) {}

    template <class In> void image(In at, int b, const float* dY) {
      if (!open) return;
      uint16_t input[IN * IN * 8];
      for (int y = 0; y < IN; y++)
        for (int x = 0; x < IN; x++)
          for (int k = 0; k < words; k++)
            input[(y * IN + x) * words + k] = nonzero(load(at(b, y, x, k * LANES)));
      for (int y = 0; y < OUT; y++)
        for (int x = 0; x < OUT; x++)
          for (uint64_t left = filters(dY + (y * OUT + x) * N) & open; left; left &= left - 1) {
            uint16_t* own = seen[__builtin_ctzll(left)];
            for (int i = 0; i < r; i++)
              for (int w = 0; w < r * words; w++)
                own[i * r * words + w] |= input[((y + i) * IN + x) * words + w];
          }
      for (uint64_t left = open; left; left &= left - 1) {
        const int o = __builtin_ctzll(left);
        uint16_t all = 0xffff;
        for (int w = 0; w < r * r * words; w++) all &= seen[o][w];
        if (all == 0xffff) open &= ~(1ull << o);
      }
    }

    void clear_weights(float* dW) const {
      for (uint64_t left = open; left; left &= left - 1) {
        const int o = __builtin_ctzll(left);
        for (int w = 0; w < r * r * words; w++)
          for (int lane = 0; lane < LANES; lane++)
            if (!(seen[o][w] >> lane & 1)) dW[((long)w * LANES + lane) * N + o] = 0;
      }
    }

    template <class Out> static void clear_input(const float* dY, int b, int K, Out dX_at) {
      bool any[OUT][OUT];
      for (int y = 0; y < OUT; y++)
        for (int x = 0; x < OUT; x++) any[y][x] = filters(dY + (y * OUT + x) * N);
      for (int y = 0; y < IN; y++)
        for (int x = 0; x < IN; x++) {
          bool reached = false;
          for (int i = 0; i < r; i++)
            for (int j = 0; j < r; j++) {
              const bool inside = y >= i && x >= j && y - i < OUT && x - j < OUT;
              reached |= inside && any[y - i][x - j];
            }
          if (!reached)
            for (int k = 0; k < K; k += LANES) store(dX_at(b, y, x, k), zero());
        }
    }

    static uint64_t filters(const float* dY) {  // those whose gradient at this position is not zero
      uint64_t found = 0;
      for (int o = 0; o < N; o += LANES) found |= (uint64_t)nonzero(load(dY + o)) << o;
      return found;
    }
  };
};

// ---- The network --------------------------------------------------------------------------------

constexpr int PIXELS = 84, FEATURES = 7 * 7 * 64, UNITS = 512;
using Conv1 = Convolution<4, 2, 21, 20, 32, 96>;  // on blocks of 4x4 pixels: K = 16 S
using Conv2 = Convolution<3, 2, 10, 9, 64, 36>;   // on blocks of 2x2 positions: K = 128
using Conv3 = Convolution<4, 3, 9, 7, 64, 24>;    // K = 64
constexpr int K2 = 128, K3 = 64;

// Observations [B][84][84][S] as the first convolution reads them: blocks of 4x4 pixels,
// [B][21][21][16 S]. Much of a game's screen stands still, so that many tiles of a batch are the
// same, byte for byte: 6 of 10 in Boxing. Each is worked on once.
struct DistinctTiles {
  int count;
  const int *firsts, *nexts;
  int first(int t) const { return firsts[t]; }
  int next(int tile) const { return nexts[tile]; }
};
struct Observations {
  static constexpr int SIDE = 21, TILE = 5;  // blocks
  Buffer<uint8_t> blocks;
  Buffer<uint64_t> hashes, distinct_hashes;
  Buffer<int> firsts, lasts, nexts, table;
  int count = 0, K = 0;  // distinct tiles; bytes of a block

  auto at() const {
    return [from = blocks.data, K = K](int image, int y, int x, int k) {
      return from + ((long)(image * SIDE + y) * SIDE + x) * K + k;
    };
  }
  DistinctTiles tiles() const { return {count, firsts.data, nexts.data}; }

  void read(const uint8_t* states, int B, int stack) {
    K = 16 * stack;
    const int row = 4 * stack;  // bytes of a block's row of pixels
    uint8_t* to = blocks.want((long)B * PIXELS * PIXELS * stack);
    for (long y = 0; y < (long)B * PIXELS; y++)
      for (int x = 0; x < SIDE; x++) {
        const uint8_t* from = states + (y * SIDE + x) * row;
        uint8_t* into = to + ((y / 4 * SIDE + x) * 4 + y % 4) * row;
        if (stack == 4) std::memcpy(into, from, 16);  // the usual size, in one move
        else std::memcpy(into, from, row);
      }
    find_distinct(B);
  }

  static uint64_t mix(uint64_t hash, uint64_t word) {
    hash = (hash ^ word) * 0x9e3779b97f4a7c15;
    return hash ^ hash >> 29;
  }
  void find_distinct(int B) {
    hashes.want((long)B * SIDE * SIDE);  // of blocks
    for (long i = 0; i < (long)B * SIDE * SIDE; i++) {
      uint64_t hash = 0, word;
      for (int k = 0; k < K; k += 8) {
        std::memcpy(&word, blocks.data + i * K + k, 8);
        hash = mix(hash, word);
      }
      hashes.data[i] = hash;
    }
    const int all = B * Conv1::TILES;
    int slots = 64;
    while (slots < 2 * all) slots *= 2;
    table.want(slots), distinct_hashes.want(all);
    firsts.want(all), lasts.want(all), nexts.want(all);
    for (int i = 0; i < slots; i++) table.data[i] = -1;
    count = 0;
    for (int tile = 0; tile < all; tile++) {
      const Conv1::Place place(tile);
      uint64_t hash = 0;
      for (int i = 0; i < TILE; i++)
        for (int j = 0; j < TILE; j++)
          hash = mix(hash, hashes.data[(place.image * SIDE + place.y + i) * SIDE + place.x + j]);
      nexts.data[tile] = -1;
      int slot = hash & (slots - 1), found;
      while ((found = table.data[slot]) >= 0 &&
             !(distinct_hashes.data[found] == hash && same(firsts.data[found], tile)))
        slot = (slot + 1) & (slots - 1);
      if (found >= 0) {
        nexts.data[lasts.data[found]] = tile;
      } else {
        table.data[slot] = found = count++;
        firsts.data[found] = tile;
        distinct_hashes.data[found] = hash;
      }
      lasts.data[found] = tile;
    }
  }
  bool same(int tile, int other) const {
    const Conv1::Place a(tile), b(other);
    for (int i = 0; i < TILE; i++)
      if (std::memcmp(at()(a.image, a.y + i, a.x, 0), at()(b.image, b.y + i, b.x, 0), TILE * K))
        return false;
    return true;
  }
};

struct Shape {
  int stack, actions, dueling;
  int K1() const { return 16 * stack; }
  int hidden() const { return dueling ? 2 * UNITS : UNITS; }  // the value stream's units come first
  int outputs() const { return (actions + LANES - 1) / LANES * LANES; }  // padded
};

// All weights in one array, and likewise their moments and gradients. `hidden` is in panels
// [units/16][FEATURES][16]; rows of the outputs are [UNITS].
enum {
  CONV1, BIAS1, CONV2, BIAS2, CONV3, BIAS3,
  HIDDEN, HIDDEN_BIAS, OUTPUT, OUTPUT_BIAS, VALUE, VALUE_BIAS, PARTS
};
struct Layout {
  long part[PARTS], start[PARTS + 1];
  explicit Layout(const Shape& s)
      : part{4L * s.K1() * 32, 32, 4L * K2 * 64, 64, 9L * K3 * 64, 64,
             (long)FEATURES * s.hidden(), s.hidden(), (long)s.actions * UNITS, s.outputs(),
             s.dueling ? UNITS : 0, s.dueling ? LANES : 0} {
    start[0] = 0;
    for (int i = 0; i < PARTS; i++) start[i + 1] = start[i] + part[i];
  }
};

struct Network {
  Shape shape;
  Layout layout;
  Buffer<float> memory, transformed, turned;
  float *weights, *U1, *U2, *U3, *UT2, *UT3, *outputs, *value;  // outputs: panels [UNITS][16]

  explicit Network(const Shape& s) : shape(s), layout(s) {
    const long size1 = Conv1::P * s.K1() * 32, size2 = Conv2::P * K2 * 64,
               size3 = Conv3::P * K3 * 64;
    const long sizes[] = {size1, size2, size3, size2, size3, s.outputs() * UNITS, UNITS * LANES};
    float** to[] = {&U1, &U2, &U3, &UT2, &UT3, &outputs, &value};
    long total = 0;
    for (long size : sizes) total += size;
    float* next = transformed.want(total);
    for (int i = 0; i < 7; i++) *to[i] = next, next += sizes[i];
    weights = memory.want(layout.start[PARTS]);
    turned.want(9 * K3 * 64);
    std::memset(weights, 0, layout.start[PARTS] * sizeof(float));
    std::memset(transformed.data, 0, total * sizeof(float));
  }
  const float* part(int which) const { return weights + layout.start[which]; }

  // To be called after every change of the weights; `gradients`: they will be asked for.
  void transform(bool gradients) {
    Conv1::transform_weights(part(CONV1), shape.K1(), 1.0f / 255, U1);  // bytes become 0 to 1 here
    Conv2::transform_weights(part(CONV2), K2, 1, U2);
    Conv3::transform_weights(part(CONV3), K3, 1, U3);
    if (gradients) {
      transpose(part(CONV2), 4, K2, 64, turned.data);
      Conv2::transform_weights(turned.data, 64, 1, UT2, K2);
      transpose(part(CONV3), 9, K3, 64, turned.data);
      Conv3::transform_weights(turned.data, 64, 1, UT3, K3);
    }
    for (int a = 0; a < shape.actions; a++)
      for (int k = 0; k < UNITS; k++)
        outputs[(a / LANES * UNITS + k) * LANES + a % LANES] = part(OUTPUT)[a * UNITS + k];
    if (shape.dueling)
      for (int k = 0; k < UNITS; k++) value[k * LANES] = part(VALUE)[k];
  }
  // [taps][K][N] to [taps][N][K]
  static void transpose(const float* W, int taps, int K, int N, float* to) {
    for (int tap = 0; tap < taps; tap++)
      for (int k0 = 0; k0 < K; k0 += LANES)
        for (int o = 0; o < N; o++)
          for (int k = k0; k < k0 + LANES; k++)
            to[((long)tap * N + o) * K + k] = W[((long)tap * K + k) * N + o];
  }
};

// What a forward pass leaves for the backward pass. Features that are zero in the whole batch are
// left out of the products (0 w + c = c while w is finite); the others are listed.
struct Pass {
  Buffer<float> V1, V2, V3, Y1, Y2, f, h, q, packed;
  int active[FEATURES], count;  // features
};

// The columns of x[B][n] that are not zero in every row; returns how many.
static int active_columns(const float* x, int B, int n, int* found) {
  int count = 0;
  for (int k = 0; k < n; k += LANES) {
    unsigned any = 0;
    for (int b = 0; b < B; b++) any |= nonzero(load(x + (long)b * n + k));
    for (; any; any &= any - 1) found[count++] = k + __builtin_ctz(any);
  }
  return count;
}

// ---- The learner --------------------------------------------------------------------------------

struct Learner {
  Shape shape;
  bool double_q;
  Network online, target;
  Buffer<float> first, second, gradient;  // Adam's moments; every gradient but the hidden layer's
  Pass on_tm1, on_t, target_t;
  Observations obs_tm1, obs_t;
  Buffer<float> M, D, dV, dU, dY1, dY2, df, dh, dh_turned, dq, d_value, scratch;

  Learner(const Shape& s, bool double_q) : shape(s), double_q(double_q), online(s), target(s) {
    const long size = online.layout.start[PARTS];
    std::memset(first.want(size), 0, size * sizeof(float));
    std::memset(second.want(size), 0, size * sizeof(float));
    gradient.want(size);
  }

  template <class X> static auto pair_at(X* Y1) {  // 2x2 positions of [20][20][32]
    return [=](int image, int y, int x, int k) {
      const int dy = k / 64, dx = k / 32 % 2;
      return Y1 + image * Conv1::OUTPUTS + ((2 * y + dy) * 20 + 2 * x + dx) * 32 + k % 32;
    };
  }
  template <class X> static auto position_at(X* Y2) {
    return [=](int image, int y, int x, int k) {
      return Y2 + image * Conv2::OUTPUTS + (y * 9 + x) * 64 + k;
    };
  }

  // Q-values [B][outputs] by one network, or by two, which share the first transform.
  void forward(const Observations& s, int B, bool keep, Network& net, Pass& pass,
               Network* other = nullptr, Pass* other_pass = nullptr) {
    const int K1 = shape.K1();
    M.want(MOST_TRANSFORMED);
    const Conv1::Filters own{net.U1, net.part(BIAS1), pass.Y1.want(B * Conv1::OUTPUTS)};
    float* V1 = pass.V1.want(Conv1::kept(keep ? s.count : MOST_TILES, K1));
    if (other) {
      float* Y1 = other_pass->Y1.want(B * Conv1::OUTPUTS);
      const Conv1::Filters its{other->U1, other->part(BIAS1), Y1};
      Conv1::forward(s.tiles(), s.at(), K1, {own, its}, V1, keep, M.data);
      forward_rest(B, keep, *other, *other_pass);
    } else {
      Conv1::forward(s.tiles(), s.at(), K1, {own}, V1, keep, M.data);
    }
    forward_rest(B, keep, net, pass);
  }
  static constexpr int MOST_TILES = 96;  // of a group
  static constexpr long MOST_TRANSFORMED = (long)MOST_TILES * 36 * 128;  // floats of its V, M or D

  void forward_rest(int B, bool keep, Network& net, Pass& pass) {
    const EveryTile tiles2{B * Conv2::TILES}, tiles3{B * Conv3::TILES};
    float* Y2 = pass.Y2.want(B * Conv2::OUTPUTS);
    Conv2::forward(tiles2, pair_at((const float*)pass.Y1.data), K2,
                   {{net.U2, net.part(BIAS2), Y2}},
                   pass.V2.want(Conv2::kept(keep ? tiles2.count : MOST_TILES, K2)), keep, M.data);
    float* f = pass.f.want((long)B * FEATURES);
    Conv3::forward(tiles3, position_at((const float*)Y2), K3, {{net.U3, net.part(BIAS3), f}},
                   pass.V3.want(Conv3::kept(keep ? tiles3.count : MOST_TILES, K3)), keep, M.data);
    // hidden layer
    const int H = shape.hidden();
    pass.count = active_columns(f, B, FEATURES, pass.active);
    float* packed = pass.packed.want((long)B * FEATURES);  // [B][count]
    for (int b = 0; b < B; b++)
      for (int i = 0; i < pass.count; i++)
        packed[(long)b * pass.count + i] = f[(long)b * FEATURES + pass.active[i]];
    int rows[FEATURES];
    for (int i = 0; i < pass.count; i++) rows[i] = pass.active[i] * LANES;
    float* h = pass.h.want((long)B * H);
    for (int j = 0; j < H; j += LANES) {
      const float* panel = net.part(HIDDEN) + (long)j * FEATURES;
      if (j + LANES < H)  // the next panel's rows, which are scattered, begin to come from memory
        for (int i = 0; i < pass.count; i++)
          _mm_prefetch((const char*)(panel + FEATURES * LANES + rows[i]), _MM_HINT_T1);
      product(B, pass.count, packed, Stride{pass.count}, Stride{1}, panel, Places{rows}, h + j, H);
      for (int b = 0; b < B; b++)
        store(h + b * H + j, relu(load(h + b * H + j) + load(net.part(HIDDEN_BIAS) + j)));
    }
    // outputs
    const int O = shape.outputs();
    float* q = pass.q.want((long)B * O);
    for (int o = 0; o < O; o += LANES)
      product(B, UNITS, h + (H - UNITS), Stride{H}, Stride{1}, net.outputs + (long)o * UNITS,
              Stride{LANES}, q + o, O);
    for (int b = 0; b < B; b++)
      for (int a = 0; a < shape.actions; a++) q[b * O + a] += net.part(OUTPUT_BIAS)[a];
    if (!shape.dueling) return;
    float* value = scratch.want((long)B * LANES);
    product(B, UNITS, h, Stride{H}, Stride{1}, net.value, Stride{LANES}, value, LANES);
    for (int b = 0; b < B; b++) {  // Q = V + A - mean A (Wang et al., 2016, equation 9)
      float mean = 0;
      for (int a = 0; a < shape.actions; a++) mean += q[b * O + a];
      const float shift = value[b * LANES] + net.part(VALUE_BIAS)[0] - mean / shape.actions;
      for (int a = 0; a < shape.actions; a++) q[b * O + a] += shift;
    }
  }

  int best(const float* q) const {  // the first of the greatest, or the first NaN
    int found = 0;
    for (int a = 1; a < shape.actions && q[found] == q[found]; a++)
      if (!(q[a] <= q[found])) found = a;
    return found;
  }

  struct Step {
    Lanes size, root_correction, epsilon;
  };
  static double power(double base, long exponent) {  // by repeated squaring, so that it is defined
    double result = 1;
    for (; exponent; exponent >>= 1, base *= base)
      if (exponent & 1) result *= base;
    return result;
  }

  // Adam (Kingma and Ba, 2015) on the 16 weights from `i` on, with gradient g
  INLINE void adam(float* weights, float* first, float* second, long i, Lanes g, const Step& step) {
    const Lanes m = fma(splat(0.1f), g - load(first + i), load(first + i));
    const Lanes v = fma(splat(0.001f), g * g, splat(0.999f) * load(second + i));
    store(first + i, m);
    store(second + i, v);
    const Lanes below = fma(root(v), step.root_correction, step.epsilon);
    store(weights + i, load(weights + i) - step.size * m / below);
  }

  // One update. loss_and_q takes the batch's mean loss and mean Q(s_tm1, a_tm1).
  void update(const uint8_t* s_tm1, const int64_t* a_tm1, const float* r_t, const float* discount_t,
              const uint8_t* s_t, int B, bool frozen, double rate, double epsilon, long t,
              double* loss_and_q) {
    const int O = shape.outputs(), A = shape.actions;
    obs_t.read(s_t, B, shape.stack);
    if (double_q) forward(obs_t, B, false, online, on_t, &target, &target_t);
    else forward(obs_t, B, false, target, target_t);
    obs_tm1.read(s_tm1, B, shape.stack);
    forward(obs_tm1, B, true, online, on_tm1);

    // target, loss and its gradient to Q(s_tm1, .), of which the advantages and the value are made
    const Pass& pass = on_tm1;
    const float *q_t = target_t.q.data, *selector_t = double_q ? on_t.q.data : q_t;
    std::memset(dq.want((long)B * O), 0, (long)B * O * sizeof(float));
    d_value.want(B);
    loss_and_q[0] = loss_and_q[1] = 0;
    for (int b = 0; b < B; b++) {
      const float value_t = q_t[b * O + best(selector_t + b * O)];
      const float wanted = r_t[b] + discount_t[b] * value_t;
      const float q = pass.q.data[b * O + a_tm1[b]], error = q - wanted;
      loss_and_q[0] += (double)error * error / B;
      loss_and_q[1] += (double)q / B;
      const float slope = 2 * error / B;
      dq.data[b * O + a_tm1[b]] = d_value.data[b] = slope;
      if (shape.dueling)  // the mean of the advantages is subtracted
        for (int a = 0; a < A; a++) dq.data[b * O + a] -= slope / A;
    }

    const Layout& at = online.layout;
    std::memset(gradient.data, 0, at.start[HIDDEN] * sizeof(float));
    std::memset(gradient.data + at.start[HIDDEN_BIAS], 0,
                (at.start[PARTS] - at.start[HIDDEN_BIAS]) * sizeof(float));
    backward_outputs(B);
    if (!frozen) backward_features(B);  // before the hidden layer's weights change
    const Step step = {splat((float)(rate / (1 - power(0.9, t)))),
                       root(splat((float)(1 / (1 - power(0.999, t))))), splat((float)epsilon)};
    update_hidden(B, step);
    if (!frozen) {
      backward_convolutions(B);
      adam_of(0, at.start[HIDDEN], step);
    }
    adam_of(at.start[HIDDEN_BIAS], at.start[PARTS], step);
    online.transform(true);
  }

  void adam_of(long from, long to, const Step& step) {
    for (long i = from; i < to; i += LANES)
      adam(online.weights, first.data, second.data, i, load(gradient.data + i), step);
  }

  // Gradients of the output layers and the hidden bias; and dh[B][H], of the hidden units
  void backward_outputs(int B) {
    const int H = shape.hidden(), O = shape.outputs();
    const long* at = online.layout.start;
    float* g = gradient.data;
    std::memset(dh.want((long)B * H), 0, (long)B * H * sizeof(float));
    for (int b = 0; b < B; b++) {
      const float *h = on_tm1.h.data + b * H, *d = dq.data + b * O;
      float* to = dh.data + b * H;
      backward_stream(d, shape.actions, h + H - UNITS, online.part(OUTPUT), to + H - UNITS,
                      g + at[OUTPUT], g + at[OUTPUT_BIAS]);
      if (shape.dueling)
        backward_stream(d_value.data + b, 1, h, online.part(VALUE), to, g + at[VALUE],
                        g + at[VALUE_BIAS]);
      for (int k = 0; k < H; k += LANES) {
        const Lanes masked = where_positive(load(h + k), load(to + k));
        store(to + k, masked);
        store(g + at[HIDDEN_BIAS] + k, load(g + at[HIDDEN_BIAS] + k) + masked);
      }
    }
  }

  // For outputs y = W h + bias with gradients d of y: dh += d W, dW += d h, d_bias += d
  static void backward_stream(const float* d, int outputs, const float* h, const float* W,
                              float* dh, float* dW, float* d_bias) {
    for (int a = 0; a < outputs; a++) {
      if (d[a] == 0) continue;
      d_bias[a] += d[a];
      for (int k = 0; k < UNITS; k += LANES) {
        store(dh + k, fma(splat(d[a]), load(W + a * UNITS + k), load(dh + k)));
        store(dW + a * UNITS + k, fma(splat(d[a]), load(h + k), load(dW + a * UNITS + k)));
      }
    }
  }

  // df[B][FEATURES] = dh W', of the features that are not zero everywhere; 16 images are a register
  void backward_features(int B) {
    const int H = shape.hidden(), padded = (B + LANES - 1) / LANES * LANES;
    int units[2 * UNITS], at_unit[2 * UNITS];
    const int count = active_columns(dh.data, B, H, units);
    for (int i = 0; i < count; i++)
      at_unit[i] = units[i] / LANES * FEATURES * LANES + units[i] % LANES;
    float* turned = dh_turned.want((long)padded * H);  // [padded/16][count][16]
    for (int b = 0; b < padded; b++)
      for (int i = 0; i < count; i++)
        turned[((long)b / LANES * count + i) * LANES + b % LANES] =
            b < B ? dh.data[(long)b * H + units[i]] : 0;
    std::memset(df.want((long)B * FEATURES), 0, (long)B * FEATURES * sizeof(float));
    for (int k = 0; k < on_tm1.count; k += SOME) {
      const int* features = on_tm1.active + k;
      const int some = on_tm1.count - k < SOME ? on_tm1.count - k : SOME;
      int at_feature[SOME];
      for (int i = 0; i < some; i++) at_feature[i] = features[i] * LANES;
      for (int b = 0; b < B; b += LANES) {
        float tile[SOME * LANES];
        product(some, count, online.part(HIDDEN), Places{at_feature}, Places{at_unit},
                turned + (long)b * count, Stride{LANES}, tile, LANES);
        for (int image = b; image < b + LANES && image < B; image++)
          for (int i = 0; i < some; i++)
            df.data[(long)image * FEATURES + features[i]] = tile[i * LANES + image - b];
      }
    }
  }
  static constexpr int SOME = 48;  // features at once

  // The hidden layer's gradient f' dh, 48 features by 16 units at a time, is used by Adam at once.
  void update_hidden(int B, const Step& step) {
    const int H = shape.hidden(), count = on_tm1.count, *features = on_tm1.active;
    for (int j = 0; j < H; j += LANES) {
      unsigned active = 0;  // units
      for (int b = 0; b < B; b++) active |= nonzero(load(dh.data + (long)b * H + j));
      const long panel = online.layout.start[HIDDEN] + (long)j * FEATURES;
      for (int k = 0, from = 0, to = 0; k < FEATURES; k += SOME, from = to) {
        while (to < count && features[to] < k + SOME) to++;
        alignas(64) float tile[SOME * LANES] = {};
        if (active) {
          product(to - from, B, on_tm1.packed.data + from, Stride{1}, Stride{count}, dh.data + j,
                  Stride{H}, tile, LANES);
          for (int i = to - 1; i >= from; i--) spread(tile, i - from, features[i] - k);
        }
        for (int i = k; i < k + SOME && i < FEATURES; i++)
          adam(online.weights, first.data, second.data, panel + (long)i * LANES,
               load(tile + (i - k) * LANES), step);
      }
    }
  }
  INLINE void spread(float* tile, int from, int to) {  // moves a row up, leaving zeros
    if (from == to) return;
    store(tile + to * LANES, load(tile + from * LANES));
    store(tile + from * LANES, zero());
  }

  // Gradients of the three convolutions, from df down
  void backward_convolutions(int B) {
    const long* at = online.layout.start;
    float* g = gradient.data;
    const Pass& pass = on_tm1;
    const long sizes[] = {B * Conv2::OUTPUTS, B * Conv1::OUTPUTS};
    std::memset(dY2.want(sizes[0]), 0, sizes[0] * sizeof(float));
    std::memset(dY1.want(sizes[1]), 0, sizes[1] * sizeof(float));
    D.want(MOST_TRANSFORMED), dV.want(MOST_TRANSFORMED), dU.want(Conv3::P * 128 * 64);
    Conv3::backward(EveryTile{B * Conv3::TILES}, B, position_at((const float*)pass.Y2.data), K3, 1,
                    pass.V3.data, pass.f.data, df.data, g + at[CONV3], g + at[BIAS3], online.UT3,
                    position_at(dY2.data), D.data, dV.data, dU.data);
    Conv2::backward(EveryTile{B * Conv2::TILES}, B, pair_at((const float*)pass.Y1.data), K2, 1,
                    pass.V2.data, pass.Y2.data, dY2.data, g + at[CONV2], g + at[BIAS2], online.UT2,
                    pair_at(dY1.data), D.data, dV.data, dU.data);
    Conv1::backward(obs_tm1.tiles(), B, obs_tm1.at(), shape.K1(), 1.0f / 255, pass.V1.data,
                    pass.Y1.data, dY1.data, g + at[CONV1], g + at[BIAS1], nullptr,
                    position_at(dY1.data), D.data, dV.data, dU.data);
  }

  // Moves the target weights by the share tau towards the online ones; 1 copies them.
  void update_target(float tau) {
    const long size = online.layout.start[PARTS];
    if (tau == 1) std::memcpy(target.weights, online.weights, size * sizeof(float));
    else
      for (long i = 0; i < size; i += LANES) {
        const Lanes there = load(target.weights + i);
        store(target.weights + i, fma(splat(tau), load(online.weights + i) - there, there));
      }
    target.transform(false);
  }
};

// ---- What Python calls --------------------------------------------------------------------------

extern "C" {

bool processor_suffices() {
#ifdef __AVX512F__
  if (!__builtin_cpu_supports("avx512f")) return false;
#endif
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}

Learner* learner_new(int stack, int actions, int dueling, int double_q) {
  try {
    return new Learner({stack, actions, dueling}, double_q);
  } catch (const std::bad_alloc&) {
    return nullptr;
  }
}
void learner_free(Learner* learner) { delete learner; }

// Where each part of the weights starts, and where the last one ends: PARTS + 1 numbers
const long* learner_layout(Learner* learner) { return learner->online.layout.start; }

// 0 online weights, 1 target weights, 2 and 3 Adam's moments
float* learner_array(Learner* learner, int which) {
  float* arrays[] = {learner->online.weights, learner->target.weights, learner->first.data,
                     learner->second.data};
  return arrays[which];
}

// To be called after the weights were written to
void learner_transform(Learner* learner) {
  FlushDenormals flush;
  learner->online.transform(true);
  learner->target.transform(false);
}

// Bytes [B][84][84][S] to q[B][A]; false if there is no memory
bool learner_q_values(Learner* learner, const uint8_t* states, int B, float* q) {
  FlushDenormals flush;
  try {
    const int A = learner->shape.actions, O = learner->shape.outputs();
    learner->obs_t.read(states, B, learner->shape.stack);
    learner->forward(learner->obs_t, B, false, learner->online, learner->on_t);
    for (int b = 0; b < B; b++)
      std::memcpy(q + (long)b * A, learner->on_t.q.data + (long)b * O, A * sizeof(float));
    return true;
  } catch (const std::bad_alloc&) {
    return false;
  }
}

// False if there is no memory: the learner may then have made half of an update
bool learner_update(Learner* learner, const uint8_t* s_tm1, const int64_t* a_tm1, const float* r_t,
                    const float* discount_t, const uint8_t* s_t, int B, bool frozen, double rate,
                    double epsilon, long t, double* loss_and_q) {
  FlushDenormals flush;
  try {
    learner->update(s_tm1, a_tm1, r_t, discount_t, s_t, B, frozen, rate, epsilon, t, loss_and_q);
    return true;
  } catch (const std::bad_alloc&) {
    return false;
  }
}

void learner_update_target(Learner* learner, float tau) {
  FlushDenormals flush;
  learner->update_target(tau);
}
}
