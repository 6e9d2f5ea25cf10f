// What the code that wrenfold emits asks of its run-time header: a view of a row-major array, nothing more.
#include <cmath>

namespace wf {
template <int Rows, int Columns, typename T>
struct view {
  T* data;
  constexpr T& operator()(int row, int column) const noexcept { return data[row * Columns + column]; }
};
template <int Rows, int Columns, typename T>
constexpr view<Rows, Columns, const T> make_input_span(const T* data) noexcept {
  return {data};
}
template <int Rows, int Columns, typename T>
constexpr view<Rows, Columns, T> make_output_span(T* data) noexcept {
  return {data};
}
}  // namespace wf
