-- What code has computed writes a minus sign as a hyphen: "-12.8 (-16.5 to -9.2)".
local function minus(word)
  word.text = word.text:gsub("^(%(?)-(%d)", "%1−%2")
  return word
end

if FORMAT ~= "typst" then return { { Str = minus } } end

Str = minus

-- Divisions that CSS styles on the page, for paper: badges, what is still absent, the row of cards.

local function wrapped(open, blocks, close)
  local result = { pandoc.RawBlock("typst", open) }
  for _, block in ipairs(blocks) do table.insert(result, block) end
  table.insert(result, pandoc.RawBlock("typst", close))
  return result
end

local WHOLE = 12 -- rows; a longer table may be broken between pages

function Table(element)
  local rows = 0
  for _, body in ipairs(element.bodies) do rows = rows + #body.body end
  if rows > WHOLE then return nil end
  return wrapped("#block(breakable: false)[", { element }, "]")
end

function Div(div)
  if div.classes:includes("badge") then
    return wrapped("#badge[", div.content, "]")
  elseif div.classes:includes("absent") then
    return wrapped("#absent[", div.content, "] <" .. div.identifier .. ">")
  elseif div.classes:includes("card") then
    local result = { pandoc.RawBlock("typst", "#cards(") }
    for _, cell in ipairs(div.content) do
      for _, block in ipairs(wrapped("[", cell.content, "],")) do table.insert(result, block) end
    end
    table.insert(result, pandoc.RawBlock("typst", ")"))
    return result
  end
end
