from gonio.board import Board, dictionaries

board = Board()
print(board)
print(dictionaries()[:2])
