// Which rows a kernel's call may store of a layer that it makes on the way to its own.
#pragma once

namespace lcdm::kernels {

// The rows that a call was asked for. It may make those around them as well; they are other calls'
// to store, perhaps at this moment.
struct OwnRows {
  int begin = 0;
  int end = 0;

  bool has(int row) const { return row >= begin && row < end; }
  // Those of the input of a convolution with this stride, which has so many times as many rows.
  OwnRows of_input(int stride) const { return {begin * stride, end * stride}; }
};

}  // namespace lcdm::kernels
