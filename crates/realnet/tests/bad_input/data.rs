//! Labelled data with mistakes.

use crate::{
    cases::{Bench, Case, run, unfit},
    common::{listing, realnet, tiny},
};
use serde_json::{Value, json};

/// Pictures `images/0.png` and `images/1.png` with a good label each.
fn data_set(bench: &Bench) -> String {
    std::fs::create_dir_all(bench.path("images")).unwrap();
    for index in 0..2 {
        tiny::picture(&bench.path(&format!("images/{index}.png")), 64, 64, 240);
        bench.write(&format!("labels/{index}.txt"), "0 0.5 0.5 0.5 0.25\n");
    }
    bench.write("data.yaml", "path: .\nval: images\nnames: [lamp]\n")
}

#[test]
fn bad_labels_are_named_by_file_line_and_value() {
    let table: [(&str, &str, &str); 9] = [
        ("a value too few", "0 0.5 0.5 0.2", "4 values"),
        ("a value too many", "0 0.5 0.5 0.2 0.1 0.9", "6 values"),
        ("commas", "0,0.5,0.5,0.2,0.1", "1 values"),
        ("a class too many", "1 0.5 0.5 0.2 0.1", "class 1 is not one of the 1 classes"),
        ("a class by name", "lamp 0.5 0.5 0.2 0.1", "\"lamp\""),
        ("pixels", "0 320 240 64 48", "value 2 is 320, outside 0..1"),
        ("a word", "0 0.5 0.5 wide 0.1", "value 4 is \"wide\""),
        ("no number", "0 0.5 nan 0.2 0.1", "value 3 is \"nan\""),
        ("a negative side", "0 0.5 0.5 -0.2 0.1", "value 4 is -0.2"),
    ];
    // Each in a data set of its own: all cases run at the end.
    let mut cases = Vec::new();
    let mut folders = Vec::new();
    for (what, row, says) in table {
        let bench = Bench::new();
        let data = data_set(&bench);
        bench.write("labels/1.txt", format!("0 0.5 0.5 0.5 0.25\n{row}\n"));
        let place = format!("{}:2", bench.text("labels/1.txt"));
        cases.push(Case::new(what, bench.val(&data, &[]), 2, &[&place, says]));
        folders.push(bench);
    }
    let bench = Bench::new();
    let data = data_set(&bench);
    let labels = bench.write("labels/1.txt", b"0 0.5 0.5 0.5 0.25\n\xff\xfe\n");
    cases.push(Case::new("bytes that are no text", bench.val(&data, &[]), 2, &[&labels, "UTF-8"]));
    run(cases);
}

#[test]
fn bad_data_files_are_named() {
    let bench = Bench::new();
    data_set(&bench);
    std::fs::create_dir(bench.path("empty")).unwrap();
    bench.write("list.txt", "images/0.png\nimages/7.png\n");
    let list = format!("{}:2", bench.text("list.txt"));
    let yaml = |name: &str, text: &str| bench.write(&format!("{name}.yaml"), text);
    let case = |what: &str, file: &str, more: &[&str], says: &[&str]| {
        Case::new(what, bench.val(file, more), 2, says)
    };
    let absent = bench.text("absent.yaml");
    let good = bench.text("data.yaml");
    let cases = vec![
        case("no such file", &absent, &[], &[&absent, "No such file"]),
        case("a folder", &bench.text("images"), &[], &["images", "directory"]),
        case("no such split", &good, &["--split", "test"], &["no `test` entry", "val"]),
        case("no names", &yaml("a", "val: images"), &[], &["a.yaml", "`names`"]),
        case("no YAML", &yaml("b", "val: [images\nnames: {"), &[], &["b.yaml", "line"]),
        case("nothing", &yaml("c", ""), &[], &["c.yaml"]),
        case("a gap", &yaml("d", "val: images\nnames: {0: a, 2: b}"), &[], &["has 2 but not 1"]),
        case("a count", &yaml("e", "val: images\nnames: [a]\nnc: 3"), &[], &["`nc` is 3"]),
        case(
            "no such path",
            &yaml("f", "path: elsewhere\nval: images\nnames: [lamp]"),
            &[],
            &["f.yaml: `path`", "elsewhere", "does not exist"],
        ),
        case(
            "no such folder",
            &yaml("g", "val: pictures\nnames: [lamp]"),
            &[],
            &["g.yaml: `val`", "pictures", "does not exist"],
        ),
        case("no pictures", &yaml("h", "val: empty\nnames: [lamp]"), &[], &["`val` has no .jpg"]),
        case(
            "a list with a mistake",
            &yaml("i", "val: list.txt\nnames: [lamp]"),
            &[],
            &[&list, "images/7.png", "does not exist"],
        ),
        case(
            "other classes",
            &yaml("j", "val: images\nnames: [sun, moon]"),
            &[],
            &["2 of the data's 2 classes", "sun, moon", "--single-cls"],
        ),
    ];
    run(cases);
}

/// A COCO file of two pictures of the data set.
fn coco() -> Value {
    let image =
        |id: u64| json!({ "id": id, "file_name": format!("{id}.png"), "width": 64, "height": 64 });
    let label =
        |id: u64| json!({ "id": id, "image_id": id, "category_id": 3, "bbox": [16, 24, 32, 16] });
    json!({
        "images": [image(0), image(1)],
        "annotations": [label(0), label(1)],
        "categories": [{ "id": 3, "name": "lamp" }],
    })
}

#[test]
fn bad_coco_files_are_named() {
    let bench = Bench::new();
    data_set(&bench);
    let images = bench.text("images");
    let good = bench.write("good.json", coco().to_string());
    let perfect = realnet(&bench.val(&good, &["--images", &images])).quiet();
    assert!(perfect.stdout.starts_with("{\"map50\":1.0,"), "{perfect:#?}");

    let changed = |name: &str, change: &dyn Fn(&mut Value)| {
        let mut value = coco();
        change(&mut value);
        bench.write(name, value.to_string())
    };
    let case = |what: &str, file: &str, says: &[&str]| {
        Case::new(what, bench.val(file, &["--images", &images]), 2, &[&[file], says].concat())
    };
    let text = coco().to_string();
    let absent = bench.text("absent.json");
    run(vec![
        case("no such file", &absent, &["No such file"]),
        case("half a file", &bench.write("a.json", &text[..text.len() / 2]), &["EOF", "line 1"]),
        case("no JSON", &bench.write("b.json", "images: []"), &["line 1"]),
        case("a list", &bench.write("c.json", "[1]"), &["line 1"]),
        case(
            "a label of no picture",
            &changed("d.json", &|v| v["annotations"][1]["image_id"] = 9.into()),
            &["annotations[1].image_id 9"],
        ),
        case(
            "a label of no category",
            &changed("e.json", &|v| v["annotations"][0]["category_id"] = 1.into()),
            &["annotations[0].category_id 1"],
        ),
        case(
            "a negative side",
            &changed("f.json", &|v| v["annotations"][1]["bbox"][2] = (-5).into()),
            &["annotations[1].bbox", "-5"],
        ),
        case(
            "two pictures of one number",
            &changed("g.json", &|v| v["images"][1]["id"] = 0.into()),
            &["images[1].id 0"],
        ),
    ]);
}

#[test]
fn one_bad_picture_costs_only_itself() {
    let bench = Bench::new();
    let data = data_set(&bench);
    bench.write("images/2.jpg", b"\xff\xd8\xff and no more");
    let save = bench.text("plots");
    let run = realnet(&bench.val(&data, &["--save", &save]));
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert_eq!(unfit(&run.stderr), [""; 0], "{run:#?}");
    assert!(run.stderr.contains("images/2.jpg"), "{run:#?}");
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!((&report["images"], &report["map50"]), (&json!(2), &json!(1.0)));
    let metrics: Value =
        serde_json::from_slice(&std::fs::read(bench.path("plots/metrics.json")).unwrap()).unwrap();
    assert_eq!(metrics, report);
    for file in listing(&bench.path("plots")) {
        let path = bench.path("plots").join(&file);
        if file.ends_with(".png") {
            realnet::picture::read(&path).unwrap();
        } else {
            let _: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        }
    }
}

#[test]
fn pictures_that_are_not_there_are_named_one_by_one() {
    let bench = Bench::new();
    data_set(&bench);
    let file = bench.write("labels.json", coco().to_string());
    std::fs::remove_file(bench.path("images/1.png")).unwrap();
    let run = realnet(&bench.val(&file, &["--images", &bench.text("images")]));
    assert_eq!(run.code, Some(2), "{run:#?}");
    assert_eq!(unfit(&run.stderr), [""; 0], "{run:#?}");
    assert!(run.stderr.contains("images/1.png") && run.stderr.contains("No such"), "{run:#?}");
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(report["images"], 1);
}
