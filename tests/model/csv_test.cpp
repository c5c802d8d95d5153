// What the trainer's tables may look like, and what is said of one that does not.
#include "model/csv.h"

#include <cmath>
#include <gtest/gtest.h>
#include <string>

#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

using Texts = std::vector<std::string>;
using Numbers = std::vector<double>;

class Csv : public ::testing::Test {
 protected:
  Result<CsvTable> read(const std::string& text) const {
    return read_csv(folder_.write("curve.csv", text));
  }
  std::string path() const { return folder_.file("curve.csv"); }

  test::TemporaryFolder folder_;
};

TEST_F(Csv, ColumnsAreFoundByNameAndReadAsNumbersOrText) {
  const auto table = read("step,pack,loss\n10,indoor,0.5\n20,scene,2.5e-1\n");
  ASSERT_TRUE(table) << table.status().text();
  EXPECT_EQ(table->header, (Texts{"step", "pack", "loss"}));
  EXPECT_EQ(table->numbers("step").value(), (Numbers{10, 20}));
  EXPECT_EQ(table->numbers("loss").value(), (Numbers{0.5, 0.25}));
  EXPECT_EQ(table->texts("pack").value(), (Texts{"indoor", "scene"}));
}

TEST_F(Csv, AnEmptyCellAndALossThatDivergedAreReadAsWhatTheyAre) {
  const auto table = read("step,loss\n1,\n2,nan\n3,-nan\n4,inf\n");
  ASSERT_TRUE(table) << table.status().text();
  const Numbers loss = table->numbers("loss").value();
  EXPECT_TRUE(std::isnan(loss[0]));
  EXPECT_TRUE(std::isnan(loss[1]));
  EXPECT_TRUE(std::isnan(loss[2]));
  EXPECT_TRUE(std::isinf(loss[3]));
}

TEST_F(Csv, AHeaderAloneIsATableWithoutRows) {
  const auto table = read("step,loss\n");
  ASSERT_TRUE(table);
  EXPECT_TRUE(table->numbers("loss").value().empty());
}

TEST_F(Csv, LinesMayEndAsOnWindows) {
  const auto table = read("step,loss\r\n1,0.5\r\n");
  ASSERT_TRUE(table);
  EXPECT_EQ(table->numbers("loss").value(), (Numbers{0.5}));
}

TEST_F(Csv, ALastLineCutOffIsLeftOutEvenWhereItLooksWhole) {
  EXPECT_EQ(read("step,loss\n1,0.5\n2,").value().rows.size(), 1U);
  EXPECT_EQ(read("step,loss\n1,0.5\n2").value().rows.size(), 1U);
  EXPECT_EQ(read("step,loss\n1,0.5\n2,0.4").value().rows.size(), 1U);
}

// RFC 4180.
TEST_F(Csv, ACellInQuotesMayHoldWhatSeparatesOthers) {
  const auto table =
      read("set,name,d1\r\n\"a, \"\"b\"\"\",\"two\nlines\",0.5\r\n\"\",\"\"\"\",1\n\"cut");
  ASSERT_TRUE(table) << table.status().text();
  EXPECT_EQ(table->texts("set").value(), (Texts{"a, \"b\"", ""}));
  EXPECT_EQ(table->texts("name").value(), (Texts{"two\nlines", "\""}));
  EXPECT_EQ(table->numbers("d1").value(), (Numbers{0.5, 1}));
}

TEST_F(Csv, AQuoteWithinACellIsOneOfItsCharacters) {
  EXPECT_EQ(read("set,d1\n5\" disk,1\n").value().texts("set").value(), (Texts{"5\" disk"}));
}

TEST_F(Csv, WhatIsWrittenAsACellIsReadBack) {
  const Texts texts = {"plain", "a, b", "\"", "\"a\",", "two\nlines", "back\r", "\r\n", " ", ""};
  std::string text = "set,d1\n";
  for (const std::string& each : texts) text += csv_cell(each) + ",1\n";
  EXPECT_EQ(read(text).value().texts("set").value(), texts);
  EXPECT_EQ(csv_cell("a 1.5"), "a 1.5") << "in quotes where it must be only";
}

TEST_F(Csv, ARowOfAnotherLengthIsNamedByItsLine) {
  const auto table = read("step,loss\n1,0.5\n2,0.4,7\n3,0.3\n");
  ASSERT_FALSE(table);
  EXPECT_EQ(table.code(), StatusCode::kCorrupt);
  EXPECT_EQ(table.status().text(), path() + ":3: 3 cells under a header of 2");
  EXPECT_EQ(read("step,loss\n1,0.5\n\n").code(), StatusCode::kCorrupt);
}

TEST_F(Csv, ACellThatIsNoNumberIsNamedByItsLine) {
  for (const std::string cell : {"fast", "0.5x", " 0.5", "1e999"}) {
    const auto table = read("step,loss\n1,0.5\n2," + cell + "\n");
    ASSERT_TRUE(table);
    const auto loss = table->numbers("loss");
    ASSERT_FALSE(loss) << cell;
    EXPECT_EQ(loss.code(), StatusCode::kCorrupt);
    EXPECT_EQ(loss.status().text(), path() + ":3: '" + cell + "' in column 'loss' is no number");
    EXPECT_TRUE(table->numbers("step"));
  }
}

TEST_F(Csv, WhatIsNotThereIsSaidSo) {
  EXPECT_EQ(read("step,loss\n").value().numbers("speed").code(), StatusCode::kNotFound);
  EXPECT_EQ(read_csv(folder_.file("none.csv")).code(), StatusCode::kNotFound);
  EXPECT_EQ(read_csv(folder_.path()).code(), StatusCode::kIoError);
  EXPECT_EQ(read("").code(), StatusCode::kCorrupt);
  EXPECT_EQ(read("step,lo").code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace lcdm::model
